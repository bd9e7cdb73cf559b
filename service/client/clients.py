"""The two drivers: flows done over httpx, in this thread or in an event loop."""

import asyncio
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import closing, contextmanager
from functools import partial, wraps
from types import TracebackType
from typing import Any, BinaryIO, Generic, ParamSpec, Self, TypeVar, overload

import httpx

from service.client import downloads, flows
from service.client.wire import Fetch, Flow, Pause, Progress, Reply, Request, Work, patient

P = ParamSpec("P")
T = TypeVar("T")
PATIENCE_SECONDS = 60.0
TIMEOUT_SECONDS = 120.0
"""For bytes to come or go; a model may be converted before the first of them comes."""
_CHUNK = 1 << 20


class _Method(Generic[P, T]):
    """A flow as a method: `Client` returns its result, `AsyncClient` an awaitable of it."""

    def __init__(self, flow: Callable[P, Flow[T]]) -> None:
        self._flow = flow
        self.__doc__ = flow.__doc__

    @overload
    def __get__(self, client: "Client", kind: object = None) -> Callable[P, T]: ...
    @overload
    def __get__(self, client: "AsyncClient", kind: object = None) -> Callable[P, Awaitable[T]]: ...
    @overload
    def __get__(self, client: None, kind: object = None) -> Callable[P, Flow[T]]: ...
    def __get__(self, client: "Client | AsyncClient | None", kind: object = None) -> Callable[P, Any]:
        if client is None:
            return self._flow

        @wraps(self._flow)
        def method(*args: P.args, **kwargs: P.kwargs) -> Any:
            return client.run(self._flow(*args, **kwargs))

        return method


class _Methods:
    """What both clients can do."""

    acquire = _Method(flows.acquire)
    acquisition = _Method(flows.acquisition)
    acquisitions = _Method(flows.acquisitions)
    add_webhook = _Method(flows.add_webhook)
    notices = _Method(flows.notices)
    asset = _Method(flows.asset)
    assets = _Method(flows.assets)
    call = _Method(flows.call)
    cancel = _Method(flows.cancel)
    claim = _Method(flows.claim)
    claims = _Method(flows.claims)
    delete_webhook = _Method(flows.delete_webhook)
    download = _Method(downloads.download)
    embed = _Method(flows.embed)
    job = _Method(flows.job)
    jobs = _Method(flows.jobs)
    jws = _Method(downloads.jws)
    me = _Method(flows.me)
    pack = _Method(downloads.pack)
    record = _Method(downloads.record)
    report = _Method(downloads.report)
    revoke_share = _Method(flows.revoke_share)
    share = _Method(flows.share)
    shares = _Method(flows.shares)
    submit_embed = _Method(flows.submit_embed)
    submit_verify = _Method(flows.submit_verify)
    upload = _Method(flows.upload)
    verify = _Method(flows.verify)
    wait = _Method(flows.wait)
    warc = _Method(downloads.warc)
    webhooks = _Method(flows.webhooks)


class Client(_Methods):
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
        self.patience = patience
        self._http = httpx.Client(
            base_url=address, headers=_authorization(api_key), timeout=TIMEOUT_SECONDS, transport=transport
        )

    def run(self, flow: Flow[T]) -> T:
        """Do a flow."""
        with closing(patient(flow, self.patience)) as steps:
            got: Any = None
            while True:
                try:
                    action = steps.send(got)
                except StopIteration as end:
                    result: T = end.value
                    return result
                got = None
                if isinstance(action, Pause):
                    time.sleep(action.seconds)
                elif isinstance(action, Work):
                    got = action.do()
                elif isinstance(action, Fetch):
                    got = self._send(action.request, action)
                else:
                    got = self._send(action)

    def _send(self, request: Request, fetch: Fetch | None = None) -> Reply:
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
                if fetch is None or not answer.is_success:
                    answer.read()
                    return _reply(answer)
                headers = _headers(answer)
                with _written(answer, fetch) as write:
                    for chunk in answer.iter_bytes(_CHUNK):
                        write(chunk)
                return Reply(answer.status_code, headers, b"")
        except httpx.RequestError as error:
            return _broken(error, headers)

    def close(self) -> None:
        """Close its connections."""
        self._http.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


class AsyncClient(_Methods):
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

    async def run(self, flow: Flow[T]) -> T:
        """Do a flow; disk and processor are kept busy in a thread."""
        with closing(patient(flow, self.patience)) as steps:
            got: Any = None
            while True:
                try:
                    action = steps.send(got)
                except StopIteration as end:
                    result: T = end.value
                    return result
                got = None
                if isinstance(action, Pause):
                    await asyncio.sleep(action.seconds)
                elif isinstance(action, Work):
                    got = await asyncio.to_thread(action.do)
                elif isinstance(action, Fetch):
                    got = await self._send(action.request, action)
                else:
                    got = await self._send(action)

    async def _send(self, request: Request, fetch: Fetch | None = None) -> Reply:
        headers: dict[str, str] = {}
        try:
            async with self._http.stream(
                request.method,
                request.path,
                headers=dict(request.headers),
                params=dict(request.params) or None,
                json=request.json,  # an empty object is a body
                content=request.content,
            ) as answer:
                if fetch is None or not answer.is_success:
                    await answer.aread()
                    return _reply(answer)
                headers = _headers(answer)
                with _written(answer, fetch) as write:
                    async for chunk in answer.aiter_bytes(_CHUNK):
                        await asyncio.to_thread(write, chunk)
                return Reply(answer.status_code, headers, b"")
        except httpx.RequestError as error:
            return _broken(error, headers)

    async def close(self) -> None:
        """Close its connections."""
        await self._http.aclose()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        await self.close()


def _authorization(api_key: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {api_key}"}


def _headers(answer: httpx.Response) -> dict[str, str]:
    return {name.lower(): value for name, value in answer.headers.items()}


def _reply(answer: httpx.Response) -> Reply:
    return Reply(answer.status_code, _headers(answer), answer.content)


def _broken(error: Exception, headers: dict[str, str] | None = None) -> Reply:
    return Reply(0, headers or {}, f"{type(error).__name__}: {error}".encode())


@contextmanager
def _written(answer: httpx.Response, fetch: Fetch) -> Iterator[Callable[[bytes], None]]:
    """Where chunks of an answer go: behind what is in the file if they are a part, in its place otherwise."""
    file: BinaryIO = fetch.file
    if answer.status_code != httpx.codes.PARTIAL_CONTENT:
        file.seek(0)
        file.truncate()
    announced = answer.headers.get("content-length", "")
    whole = file.tell() + (int(announced) if announced.isdigit() else 0)
    yield partial(_write, file, whole, fetch.progress)


def _write(file: BinaryIO, whole: int, progress: Progress, chunk: bytes) -> None:
    file.write(chunk)
    progress("download", min(1.0, file.tell() / whole) if whole else 0.0)
