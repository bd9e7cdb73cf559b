"""The two clients: requests over httpx, in this thread or in an event loop."""

import asyncio
import time
from collections.abc import Callable, Coroutine
from functools import partial, wraps
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

import httpx

from service.client.downloads import Methods
from service.client.wire import Reply, Request, Sink

P = ParamSpec("P")
T = TypeVar("T")
PATIENCE_SECONDS = 60.0
TIMEOUT_SECONDS = 120.0
"""For bytes to come or go; a model may be converted before the first of them comes."""
_CHUNK = 1 << 20


class AsyncClient(Methods):
    """As `Client`, each method awaited, in an `async with`."""

    def __init__(
        self,
        address: str,
        api_key: str,
        *,
        patience: float = PATIENCE_SECONDS,
        transport: httpx.AsyncBaseTransport | None = None,
    ) -> None:
        self.patience = patience
        self._http = httpx.AsyncClient(
            base_url=address, headers=_authorization(api_key), timeout=TIMEOUT_SECONDS, transport=transport
        )

    async def _exchange(self, request: Request, sink: Sink | None) -> Reply:
        headers: dict[str, str] = {}
        try:
            async with self._http.stream(**_arguments(request)) as answer:
                if sink is None or not answer.is_success:
                    return Reply(answer.status_code, _headers(answer), await answer.aread())
                headers = _headers(answer)
                sink.begin(answer.status_code, headers.get("content-length", ""))
                async for chunk in answer.aiter_bytes(_CHUNK):
                    await self._work(partial(sink.write, chunk))
                return Reply(answer.status_code, headers, b"")
        except httpx.RequestError as error:
            return _broken(error, headers)

    async def _pause(self, seconds: float) -> None:
        await asyncio.sleep(seconds)

    async def _work(self, do: Callable[[], T]) -> T:
        return await asyncio.to_thread(do)

    async def close(self) -> None:
        """Close its connections."""
        await self._http.aclose()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        await self.close()


class _Blocking(Methods):
    """The same in this thread: nothing here waits for an event loop, so each method is done in its first step."""

    def __init__(self, http: httpx.Client, patience: float) -> None:
        self.http, self.patience = http, patience

    async def _exchange(self, request: Request, sink: Sink | None) -> Reply:
        headers: dict[str, str] = {}
        try:
            with self.http.stream(**_arguments(request)) as answer:
                if sink is None or not answer.is_success:
                    return Reply(answer.status_code, _headers(answer), answer.read())
                headers = _headers(answer)
                sink.begin(answer.status_code, headers.get("content-length", ""))
                for chunk in answer.iter_bytes(_CHUNK):
                    sink.write(chunk)
                return Reply(answer.status_code, headers, b"")
        except httpx.RequestError as error:
            return _broken(error, headers)

    async def _pause(self, seconds: float) -> None:
        time.sleep(seconds)

    async def _work(self, do: Callable[[], T]) -> T:
        return do()


def _now(method: Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]) -> Callable[Concatenate["Client", P], T]:
    """A method of `Client`, which returns what that of `AsyncClient` gives an awaitable of."""

    @wraps(method)
    def done(client: "Client", /, *args: P.args, **kwargs: P.kwargs) -> T:
        try:
            method(client._line, *args, **kwargs).send(None)
        except StopIteration as end:
            result: T = end.value
            return result
        raise AssertionError("a step of a blocking client waited")

    return done


class Client:
    """A tenant's client of one service; closes its connections at the end of a `with`.

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
        http = httpx.Client(
            base_url=address, headers=_authorization(api_key), timeout=TIMEOUT_SECONDS, transport=transport
        )
        self._line = _Blocking(http, patience)

    acquire = _now(Methods.acquire)
    acquisition = _now(Methods.acquisition)
    acquisitions = _now(Methods.acquisitions)
    add_webhook = _now(Methods.add_webhook)
    asset = _now(Methods.asset)
    assets = _now(Methods.assets)
    call = _now(Methods.call)
    cancel = _now(Methods.cancel)
    claim = _now(Methods.claim)
    claims = _now(Methods.claims)
    delete_webhook = _now(Methods.delete_webhook)
    download = _now(Methods.download)
    embed = _now(Methods.embed)
    job = _now(Methods.job)
    jobs = _now(Methods.jobs)
    jws = _now(Methods.jws)
    me = _now(Methods.me)
    notices = _now(Methods.notices)
    pack = _now(Methods.pack)
    record = _now(Methods.record)
    report = _now(Methods.report)
    revoke_share = _now(Methods.revoke_share)
    share = _now(Methods.share)
    shares = _now(Methods.shares)
    submit_embed = _now(Methods.submit_embed)
    submit_verify = _now(Methods.submit_verify)
    upload = _now(Methods.upload)
    verify = _now(Methods.verify)
    wait = _now(Methods.wait)
    warc = _now(Methods.warc)
    webhooks = _now(Methods.webhooks)

    def close(self) -> None:
        """Close its connections."""
        self._line.http.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def _authorization(api_key: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {api_key}"}


def _arguments(request: Request) -> dict[str, Any]:
    """Of httpx."""
    return {
        "method": request.method,
        "url": request.path,
        "headers": dict(request.headers),
        "params": dict(request.params) or None,
        "json": request.json,  # an empty object is a body
        "content": request.content,
    }


def _headers(answer: httpx.Response) -> dict[str, str]:
    return {name.lower(): value for name, value in answer.headers.items()}


def _broken(error: Exception, headers: dict[str, str]) -> Reply:
    return Reply(0, headers, f"{type(error).__name__}: {error}".encode())
