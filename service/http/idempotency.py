"""`Idempotency-Key`: a request that is sent again is answered again, and done once (an expired IETF draft)."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import sqlalchemy as sa

from service.clock import ago, now
from service.db import Database
from service.db.schema import idempotency
from service.problems import Problem
from service.trust.api_keys import Caller

IN_FLIGHT_HOURS = 1 / 60
"""A first request not finished by then died; the next with its key takes its place."""

KEPT_HOURS = 24.0


def begin(
    db: Database, caller: Caller, key: str, body: Mapping[str, Any], in_flight_hours: float = IN_FLIGHT_HOURS
) -> str | None:
    """Id of what the first request with this key made, such as a job, or None for the first itself.

    idempotency-mismatch for another body, request-in-flight while the first is still being answered.
    """
    digest = hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()
    mine, values = _mine(caller, key), {"tenant": caller.tenant, "key": _kept(caller, key)}
    with db.write() as connection:
        connection.execute(sa.delete(idempotency).where(idempotency.c.created_at < ago(KEPT_HOURS)))
        row = connection.execute(sa.select(idempotency).where(mine)).first()
        if row is None:
            connection.execute(idempotency.insert().values(values | {"body_hash": digest, "created_at": now()}))
            return None
        if row.body_hash != digest:
            raise Problem("idempotency-mismatch", f"Idempotency-Key {key!r} came with another body before")
        if row.job is not None:
            return str(row.job)
        if row.created_at > ago(in_flight_hours):
            text = f"the first request with Idempotency-Key {key!r} is not answered yet"
            raise Problem("request-in-flight", text, headers={"Retry-After": "1"})
        connection.execute(sa.update(idempotency).where(mine).values(created_at=now()))
        return None


def settle(db: Database, caller: Caller, key: str, made: str) -> None:
    """The first request made what it is for."""
    db.change(sa.update(idempotency).where(_mine(caller, key)).values(job=made))


def release(db: Database, caller: Caller, key: str) -> None:
    """The first request failed before it made anything: the key is free again."""
    db.change(sa.delete(idempotency).where(_mine(caller, key) & idempotency.c.job.is_(None)))


def _kept(caller: Caller, key: str) -> str:
    """Clients of two API keys may draw the same one, and must not be handed each other's jobs."""
    return f"{caller.key_id} {key}"


def _mine(caller: Caller, key: str) -> sa.ColumnElement[bool]:
    return (idempotency.c.tenant == caller.tenant) & (idempotency.c.key == _kept(caller, key))
