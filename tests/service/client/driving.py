"""Both drivers of the client, over a service that a test plays."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any

import httpx

from service.client import AsyncClient, Client

ADDRESS = "http://service.test"
DRIVERS = ("sync", "async")
Handler = Callable[[httpx.Request], httpx.Response]


def do(driver: str, handler: Handler, method: str, *args: Any, patience: float = 60.0, **kwargs: Any) -> Any:
    """What a method of a client gives, the service's answers being those of `handler`."""
    transport = httpx.MockTransport(handler)
    if driver == "sync":
        with Client(ADDRESS, "mk_a_b", patience=patience, transport=transport) as client:
            return getattr(client, method)(*args, **kwargs)

    async def run() -> Any:
        async with AsyncClient(ADDRESS, "mk_a_b", patience=patience, transport=transport) as client:
            return await getattr(client, method)(*args, **kwargs)

    return asyncio.run(run())


class Breaking(httpx.SyncByteStream, httpx.AsyncByteStream):
    """A body of which some comes, and then the connection breaks."""

    def __init__(self, some: bytes) -> None:
        self.some = some

    def __iter__(self) -> Iterator[bytes]:
        yield self.some
        raise httpx.ReadError("broken")

    async def __aiter__(self) -> AsyncIterator[bytes]:
        yield self.some
        raise httpx.ReadError("broken")


def problem(kind: str, status: int, **members: Any) -> httpx.Response:
    """A problem as the service says it."""
    plain = {"type": f"urn:mark3dgs:problem:{kind}", "title": "T", "status": status, "detail": "the value 7"}
    return httpx.Response(status, json={**plain, "request_id": "r1", **members})


def job(state: str, **members: Any) -> dict[str, Any]:
    """A job as the service says it."""
    times = {"created_at": "2026-01-01T00:00:00+00:00", "started_at": None, "finished_at": None}
    plain = {"id": "job_1", "kind": "embed", "state": state, "stage": "look", "fraction": 0.5, "cancelling": False}
    return {**plain, "result": None, "problem": None, **times, **members}
