"""What there is: lists, from newest to oldest, narrowed where one asks for it; and who asks."""

from collections.abc import Mapping, Sequence
from typing import Literal, TypeVar

from service.client.answers import Asset, ClaimSummary, Job, Me, read
from service.client.flows import call
from service.client.wire import Flow

A = TypeVar("A")
State = Literal["queued", "running", "succeeded", "disputed", "failed", "cancelled"]


def me() -> Flow[Me]:
    """Whose API key this is, what it may do, and how much of the tenant's limits is used."""
    return read(Me, (yield from call("GET", "/v1/me")))


def assets(*, q: str = "", original: str = "") -> Flow[list[Asset]]:
    """Assets of the tenant: all, whose label, copy name, id or record id holds `q`, or of one original (SHA-256)."""
    return (yield from _all(Asset, "/v1/assets", {"q": q, "original": original}))


def claims(
    *, q: str = "", verdict: Literal["", "marked", "not_marked", "inconclusive"] = "", asset: str = ""
) -> Flow[list[ClaimSummary]]:
    """Claims of the tenant: all; with a verdict; about the asset of an id; or found by `q`, a part of a suspect's file
    name, of an id, label or copy name, or a suspect's SHA-256."""
    return (yield from _all(ClaimSummary, "/v1/claims", {"q": q, "verdict": verdict, "asset": asset}))


def jobs(*, state: Sequence[State] = (), kind: Literal["", "embed", "verify", "dispute"] = "") -> Flow[list[Job]]:
    """Jobs of the tenant: all, in one of some states, or of a kind."""
    return (yield from _all(Job, "/v1/jobs", {"state": state, "kind": kind}))


def _all(kind: type[A], path: str, narrowed: Mapping[str, str | Sequence[str]]) -> Flow[list[A]]:
    found: list[A] = []
    given = {name: value for name, value in narrowed.items() if value}
    after: str | None = ""
    while after is not None:
        page = yield from call("GET", path, params={"limit": "100", "after": after, **given})
        found += [read(kind, each) for each in page["items"]]
        after = page["next"]
    return found
