"""Requests over httpx, their answers, and which requests are sent again."""

import random
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from json import loads
from types import TracebackType
from typing import Any, BinaryIO, Self

import httpx

from service.client.errors import ServiceError, of_problem

Progress = Callable[[str, float], object]
"""Called with a stage ("upload", those of a job, "download") and how far that is, 0 to 1."""

Params = Mapping[str, str | Sequence[str]]
"""Of an address; one of several values is there several times."""

PARTIAL_CONTENT, REFUSED_FOR_NOW = 206, (429, 503)
FIRST_PAUSE, LONGEST_PAUSE = 0.5, 10.0
"""Seconds between tries, doubled each time, and drawn from half of that on, lest all clients come back together."""
PATIENCE_SECONDS = 60.0
TIMEOUT_SECONDS = 120.0
"""For bytes to come or go; a model may be converted before the first of them comes."""
BREAKS = 3
"""Broken connections in a row, with nothing gone or come in between, after which a file is given up."""
_CHUNK = 1 << 20


@dataclass(frozen=True)
class Request:
    """One request."""

    method: str
    path: str
    params: Params = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    json: Any = None
    content: bytes | None = None
    again: bool = False  # done twice it is done once: sent again where no answer came


class Sink:
    """A file that takes the body of an answer."""

    def __init__(self, file: BinaryIO, progress: Progress) -> None:
        self._file, self._progress, self._whole = file, progress, 0

    def begin(self, status: int, announced: str) -> None:
        """A part (206) goes behind what is in the file, everything else in its place; `announced`: Content-Length."""
        if status != PARTIAL_CONTENT:
            self._file.seek(0)
            self._file.truncate()
        self._whole = self._file.tell() + (int(announced) if announced.isdigit() else 0)

    def write(self, chunk: bytes) -> None:
        """What came."""
        self._file.write(chunk)
        self._progress("download", min(1.0, self._file.tell() / self._whole) if self._whole else 0.0)


@dataclass(frozen=True)
class Reply:
    """An answer; status 0 and the reason in `body` where none came, or it broke off."""

    status: int
    headers: Mapping[str, str]  # names in lower case
    body: bytes

    @property
    def good(self) -> bool:
        """Whether the request succeeded."""
        return 200 <= self.status < 300

    def json(self) -> Any:
        """What the body says; ServiceError "unexpected-answer" where that is no JSON."""
        try:
            return loads(self.body)
        except (ValueError, RecursionError):
            raise self._unexpected() from None

    def error(self) -> ServiceError:
        """The error of a bad answer."""
        if self.status == 0:
            return ServiceError("unreachable", self.body.decode())
        try:
            return of_problem(loads(self.body), self.retry_after())
        except (KeyError, TypeError, ValueError, RecursionError):
            return self._unexpected()

    def retry_after(self) -> float | None:
        """Seconds of Retry-After, which says a number or a date (RFC 9110, 10.2.3)."""
        text = self.headers.get("retry-after", "").strip()
        if text.isascii() and text.isdigit():
            return float(text)
        try:
            return max(0.0, (parsedate_to_datetime(text) - datetime.now(UTC)).total_seconds())
        except (TypeError, ValueError):  # none, unreadable, or of no zone
            return None

    def _unexpected(self) -> ServiceError:
        said = self.body[:200].decode(errors="replace")
        text = f"status {self.status} with what this API never says: {said!r}"
        return ServiceError("unexpected-answer", text, status=self.status, retry_after=self.retry_after())


class Line:
    """Sends requests; several threads may share one.

    Parameters
    ----------
    address : str
        Such as http://127.0.0.1:8000.
    api_key : str
        mk_...
    patience : float
        Seconds that one request refused with 429 or 503 is repeated; 0 never.
    transport : httpx.BaseTransport, optional
        How requests travel, for tests and for other ways than the network.
    """

    def __init__(
        self,
        address: str,
        api_key: str,
        *,
        patience: float = PATIENCE_SECONDS,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        self.patience = patience
        self._http = httpx.Client(
            base_url=address,
            headers={"Authorization": f"Bearer {api_key}"},
            timeout=TIMEOUT_SECONDS,
            transport=transport,
        )

    def close(self) -> None:
        """Close its connections."""
        self._http.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _exchange(self, request: Request, sink: Sink | None) -> Reply:
        """Send a request once; with a `sink`, the body of a good answer goes there."""
        headers: dict[str, str] = {}
        try:
            with self._http.stream(
                request.method,
                request.path,
                headers=dict(request.headers),
                params=dict(request.params) or None,
                json=request.json,  # an empty object is a body
                content=request.content,
            ) as answer:
                headers = {name.lower(): value for name, value in answer.headers.items()}
                if sink is None or not answer.is_success:
                    return Reply(answer.status_code, headers, answer.read())
                sink.begin(answer.status_code, headers.get("content-length", ""))
                for chunk in answer.iter_bytes(_CHUNK):
                    sink.write(chunk)
                return Reply(answer.status_code, headers, b"")
        except httpx.RequestError as error:
            return Reply(0, headers, f"{type(error).__name__}: {error}".encode())

    def _send(self, request: Request, sink: Sink | None = None) -> Reply:
        """The answer to a request, sent again after 429 and 503, and after no answer where that is harmless.

        Waits for as long as Retry-After says, and no longer than `patience`: then the answer is what it is. Every other
        status is an answer.
        """
        waited, backoff = 0.0, FIRST_PAUSE
        while True:
            reply = self._exchange(request, sink)
            seconds = max(backoff * random.uniform(0.5, 1.0), reply.retry_after() or 0.0)
            unanswered = reply.status == 0 and request.again
            if not (unanswered or reply.status in REFUSED_FOR_NOW) or waited + seconds > self.patience:
                return reply
            time.sleep(seconds)
            waited, backoff = waited + seconds, min(2 * backoff, LONGEST_PAUSE)

    def _ask(self, request: Request) -> Reply:
        """The answer to a request; ServiceError for a bad one."""
        reply = self._send(request)
        if not reply.good:
            raise reply.error()
        return reply
