"""The two drivers: flows done over httpx, in this thread or in an event loop."""

import asyncio
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import closing, contextmanager
from functools import partial, wraps
from types import TracebackType
from typing import Any, BinaryIO, Concatenate, ParamSpec, Self, TypeVar

import httpx

from service.client import downloads, flows, lists, sharing
from service.client import webhooks as hooks
from service.client.wire import Fetch, Flow, Pause, Progress, Reply, Request, Work, patient

P = ParamSpec("P")
T = TypeVar("T")
PATIENCE_SECONDS = 60.0
TIMEOUT_SECONDS = 120.0
"""For bytes to come or go; a model may be converted before the first of them comes."""
_CHUNK = 1 << 20


def _now(flow: Callable[P, Flow[T]]) -> "Callable[Concatenate[Client, P], T]":
    @wraps(flow)
    def method(self: "Client", /, *args: P.args, **kwargs: P.kwargs) -> T:
        return self.run(flow(*args, **kwargs))

    return method


def _soon(flow: Callable[P, Flow[T]]) -> "Callable[Concatenate[AsyncClient, P], Awaitable[T]]":
    @wraps(flow)
    def method(self: "AsyncClient", /, *args: P.args, **kwargs: P.kwargs) -> Awaitable[T]:
        return self.run(flow(*args, **kwargs))

    return method


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
        self.patience = patience
        self._http = httpx.Client(transport=transport, **_settings(address, api_key))

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
                    got = self._fetch(action)
                else:
                    got = self._send(action)

    def _send(self, request: Request) -> Reply:
        try:
            return _reply(self._http.request(**_arguments(request)))
        except httpx.RequestError as error:
            return _broken(error)

    def _fetch(self, fetch: Fetch) -> Reply:
        headers: dict[str, str] = {}
        try:
            with self._http.stream(**_arguments(fetch.request)) as answer:
                if not answer.is_success:
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

    add_webhook = _now(hooks.add_webhook)
    asset = _now(flows.asset)
    assets = _now(lists.assets)
    call = _now(flows.call)
    cancel = _now(flows.cancel)
    claim = _now(flows.claim)
    claims = _now(lists.claims)
    delete_webhook = _now(hooks.delete_webhook)
    download = _now(downloads.download)
    embed = _now(flows.embed)
    job = _now(flows.job)
    jobs = _now(lists.jobs)
    jws = _now(downloads.jws)
    me = _now(lists.me)
    record = _now(downloads.record)
    report = _now(downloads.report)
    revoke_share = _now(sharing.revoke_share)
    share = _now(sharing.share)
    shares = _now(sharing.shares)
    submit_embed = _now(flows.submit_embed)
    submit_verify = _now(flows.submit_verify)
    upload = _now(flows.upload)
    verify = _now(flows.verify)
    wait = _now(flows.wait)
    webhooks = _now(hooks.webhooks)


class AsyncClient:
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
        self._http = httpx.AsyncClient(transport=transport, **_settings(address, api_key))

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
                    got = await self._fetch(action)
                else:
                    got = await self._send(action)

    async def _send(self, request: Request) -> Reply:
        try:
            return _reply(await self._http.request(**_arguments(request)))
        except httpx.RequestError as error:
            return _broken(error)

    async def _fetch(self, fetch: Fetch) -> Reply:
        headers: dict[str, str] = {}
        try:
            async with self._http.stream(**_arguments(fetch.request)) as answer:
                if not answer.is_success:
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

    add_webhook = _soon(hooks.add_webhook)
    asset = _soon(flows.asset)
    assets = _soon(lists.assets)
    call = _soon(flows.call)
    cancel = _soon(flows.cancel)
    claim = _soon(flows.claim)
    claims = _soon(lists.claims)
    delete_webhook = _soon(hooks.delete_webhook)
    download = _soon(downloads.download)
    embed = _soon(flows.embed)
    job = _soon(flows.job)
    jobs = _soon(lists.jobs)
    jws = _soon(downloads.jws)
    me = _soon(lists.me)
    record = _soon(downloads.record)
    report = _soon(downloads.report)
    revoke_share = _soon(sharing.revoke_share)
    share = _soon(sharing.share)
    shares = _soon(sharing.shares)
    submit_embed = _soon(flows.submit_embed)
    submit_verify = _soon(flows.submit_verify)
    upload = _soon(flows.upload)
    verify = _soon(flows.verify)
    wait = _soon(flows.wait)
    webhooks = _soon(hooks.webhooks)


def _settings(address: str, api_key: str) -> dict[str, Any]:
    headers = {"Authorization": f"Bearer {api_key}"}
    return {"base_url": address, "headers": headers, "timeout": TIMEOUT_SECONDS, "follow_redirects": False}


def _arguments(request: Request) -> dict[str, Any]:
    plain = {"method": request.method, "url": request.path, "headers": dict(request.headers)}
    given = {"params": dict(request.params) or None, "json": request.json, "content": request.content}
    return plain | {name: value for name, value in given.items() if value is not None}  # an empty object is a body


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
