"""The actions of a driver as values, and which requests are sent again. No input or output here.

A *flow* is a generator: it yields actions, gets the outcome of each, and returns its result. The two drivers
(`clients.py`) differ only in how they do an action.
"""

import random
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from json import loads
from typing import Any, BinaryIO, TypeVar

from service.client.errors import ServiceError, of_problem

T = TypeVar("T")
Progress = Callable[[str, float], object]
"""Called with a stage ("upload", those of a job, "download") and how far that is, 0 to 1."""

Params = Mapping[str, str | Sequence[str]]
"""Of an address; one of several values is there several times."""

REFUSED_FOR_NOW = (429, 503)
FIRST_PAUSE, LONGEST_PAUSE = 0.5, 10.0
"""Seconds between tries, doubled each time, and drawn from half of that on, lest all clients come back together."""
BREAKS = 3
"""Broken connections in a row, with nothing gone or come in between, after which a file is given up."""


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


@dataclass(frozen=True)
class Fetch:
    """A request whose answer goes to a file: to its end if it is a part (206), in place of all of it else."""

    request: Request
    file: BinaryIO
    progress: Progress


@dataclass(frozen=True)
class Pause:
    """Seconds in which nothing is done."""

    seconds: float


@dataclass(frozen=True)
class Work:
    """Work of a disk or a processor, not of the network."""

    do: Callable[[], Any]


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


Action = Request | Fetch | Pause | Work
Flow = Generator[Action, Any, T]


def patient(flow: Flow[T], patience: float) -> Flow[T]:
    """The flow, whose requests are sent again after 429 and 503, and after no answer where that is harmless.

    Waits for as long as Retry-After says, and no longer than `patience` seconds for one request: then the flow is
    handed the answer as it is. Every other status is an answer.
    """
    with closing(flow):
        got: Any = None
        while True:
            try:
                action = flow.send(got)
            except StopIteration as end:
                result: T = end.value
                return result
            got = yield action
            waited, backoff = 0.0, FIRST_PAUSE
            while isinstance(got, Reply) and _worth_another(action, got):
                seconds = max(backoff * random.uniform(0.5, 1.0), got.retry_after() or 0.0)
                if waited + seconds > patience:
                    break
                yield Pause(seconds)
                waited, backoff = waited + seconds, min(2 * backoff, LONGEST_PAUSE)
                got = yield action


def _worth_another(action: Action, reply: Reply) -> bool:
    unanswered = reply.status == 0 and isinstance(action, Request) and action.again
    return unanswered or reply.status in REFUSED_FOR_NOW


def ask(request: Request) -> Flow[Reply]:
    """The answer to a request; ServiceError for a bad one."""
    reply: Reply = yield request
    if not reply.good:
        raise reply.error()
    return reply
