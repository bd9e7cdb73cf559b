"""Addresses under which strangers see a claim's report for a time."""

from service.client.answers import Share, read
from service.client.flows import address, call
from service.client.wire import Flow


def share(claim_id: str, *, days: int = 14) -> Flow[Share]:
    """Make one that stands for 1 to 90 days; its `url` is shown only once."""
    return read(Share, (yield from call("POST", address("claims", claim_id, "share"), json={"days": days})))


def shares(claim_id: str) -> Flow[list[Share]]:
    """Those of a claim that stand, newest first."""
    found = yield from call("GET", address("claims", claim_id, "shares"))
    return [read(Share, each) for each in found["items"]]


def revoke_share(share_id: str) -> Flow[None]:
    """End one before its time."""
    yield from call("DELETE", address("shares", share_id))
