"""The client, over a service that a test plays."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import httpx

from service.client import Client

ADDRESS = "http://service.test"
Handler = Callable[[httpx.Request], httpx.Response]


def do(handler: Handler, method: str, *args: Any, patience: float = 60.0, **kwargs: Any) -> Any:
    """What a method of the client gives, the service's answers being those of `handler`."""
    with Client(ADDRESS, "mk_a_b", patience=patience, transport=httpx.MockTransport(handler)) as client:
        return getattr(client, method)(*args, **kwargs)


class Breaking(httpx.SyncByteStream):
    """A body of which some comes, and then the connection breaks."""

    def __init__(self, some: bytes) -> None:
        self.some = some

    def __iter__(self) -> Iterator[bytes]:
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
