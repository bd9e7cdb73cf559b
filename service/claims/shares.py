"""Addresses that show a claim to anyone for a time: a token each, of which only the digest is kept."""

import json
import secrets
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from typing import Any

import sqlalchemy as sa

from service.clock import now
from service.core import Service
from service.db import Database, missing
from service.db.schema import claims, shares
from service.problems import Problem
from service.trust import audit
from service.trust.api_keys import Caller

TOKEN_BYTES = 32
MOST = 20
"""Addresses of one claim at a time."""


def share(service: Service, caller: Caller, claim: Any, days: int) -> tuple[str, Any]:
    """Token and row of a new share of a claim (its row). The log says who shared what, and not the token.

    conflict for a claim whose report shows the unmarked original, as those of earlier versions do; budget-exceeded
    where it has MOST shares.
    """
    from service.claims.pack import shown_in_pack

    pictures = json.loads(claim.pictures)
    if set(shown_in_pack(pictures)) != set(pictures):
        text = "the report of this claim shows the unmarked original and cannot be shared; check the suspect again"
        raise Problem("conflict", text)
    token, share_id = secrets.token_urlsafe(TOKEN_BYTES), f"sh_{secrets.token_hex(12)}"
    until = (datetime.now(UTC) + timedelta(days=days)).isoformat(timespec="microseconds")
    values = {"id": share_id, "tenant": caller.tenant, "claim": claim.id, "digest": _digest(token)}
    with service.db.exclusive() as connection:
        if len(_standing(connection, claim.id)) >= MOST:
            raise Problem("budget-exceeded", f"{MOST} addresses of this claim stand: revoke one")
        connection.execute(shares.insert().values(**values, created_at=now(), expires_at=until))
        facts = {"share": share_id, "api_key": caller.key_id, "expires_at": until}
        audit.append(connection, caller.tenant, "claim.shared", facts, claim.id)
        row = connection.execute(sa.select(shares).where(shares.c.id == share_id)).one()
    return token, row


def shares_of(db: Database, claim_id: str) -> list[Any]:
    """Rows of the shares of a claim that stand, newest first."""
    with db.read() as connection:
        return _standing(connection, claim_id)


def revoke(db: Database, caller: Caller, row: Any) -> None:
    """End a share; not-found where another request was faster."""
    with db.exclusive() as connection:
        if connection.execute(sa.delete(shares).where(shares.c.id == row.id)).rowcount == 0:
            raise missing(shares, row.id)
        facts = {"share": row.id, "api_key": caller.key_id}
        audit.append(connection, caller.tenant, "claim.share_revoked", facts, row.claim)


def shared(db: Database, token: str) -> Any:
    """The row of the claim that a token is for; not-found alike for unknown, expired and revoked ones."""
    this = (shares.c.digest == _digest(token)) & (shares.c.expires_at > now())
    row = db.query(sa.select(claims).join(shares, shares.c.claim == claims.c.id).where(this)).first()
    if row is None:
        raise Problem("not-found", "there is nothing at this address, or not any more")
    return row


def sweep(db: Database) -> int:
    """Forget shares that have expired, and those of claims that are gone; how many."""
    gone = (shares.c.expires_at <= now()) | shares.c.claim.not_in(sa.select(claims.c.id))
    return db.change(sa.delete(shares).where(gone))


def _standing(connection: sa.Connection, claim_id: str) -> list[Any]:
    this = (shares.c.claim == claim_id) & (shares.c.expires_at > now())
    return list(connection.execute(sa.select(shares).where(this).order_by(shares.c.created_at.desc(), shares.c.id)))


def _digest(token: str) -> str:
    """A plain hash is enough: 256 random bits cannot be guessed."""
    return sha256(token.encode()).hexdigest()
