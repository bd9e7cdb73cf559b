"""Tenants, whose ids operators choose, and their API keys: `mk_<id>_<secret>`, bound to a tenant and scopes.

Of a key's secret only a keyed hash is kept.
"""

import re
import secrets
from collections.abc import Iterable
from dataclasses import dataclass

import sqlalchemy as sa

from service.clock import now
from service.db import Database
from service.db.schema import api_keys, tenants
from service.problems import Problem
from service.trust import audit
from service.trust.master import MasterKey

MOST_CHARACTERS = 100
FIRST_TENANT = "default"
"""Tenant of the first API key; not a name."""


def check_tenant(tenant: str) -> None:
    """invalid-request unless an id is 1 to 100 printable characters without blanks around them."""
    if not (tenant and tenant.isprintable() and tenant == tenant.strip() and len(tenant) <= MOST_CHARACTERS):
        text = f"a tenant is named by 1 to {MOST_CHARACTERS} printable characters without blanks around: {tenant!r}"
        raise Problem("invalid-request", text)


def display_name(connection: sa.Connection, tenant: str) -> str:
    """Display name of a tenant; its id where none was set."""
    found = connection.execute(sa.select(tenants.c.name).where(tenants.c.id == tenant)).scalar_one_or_none()
    return str(found or tenant)


def name_tenant(db: Database, tenant: str, name: str) -> None:
    """Set a tenant's display name, for later claims; "not-found" where it has no API key. The log keeps each name."""
    check_tenant(name)
    with db.exclusive() as connection:
        if connection.execute(sa.select(api_keys.c.id).where(api_keys.c.tenant == tenant).limit(1)).first() is None:
            raise Problem("not-found", f"there is no tenant {tenant!r}: it has no API key")
        connection.execute(sa.delete(tenants).where(tenants.c.id == tenant))
        connection.execute(tenants.insert().values(id=tenant, name=name))
        audit.append(connection, tenant, "tenant.named", {"name": name}, tenant)


OPERATOR = "operator"
SCOPES = ("embed", "verify", "read", "originals", "admin", OPERATOR)
"""`originals`: unmarked originals and records. `admin` implies those before it, within its tenant; `operator` is for
the operator: metrics, and disputes between any two tenants."""

_TOKEN = re.compile(r"mk_([0-9a-f]{16})_([0-9a-f]{64})", re.ASCII)
PURPOSE = "api key"


@dataclass(frozen=True)
class Caller:
    """The caller: tenant, public id of the key, and what it may do (all of it, where `admin` is among it)."""

    tenant: str
    key_id: str
    scopes: frozenset[str]

    def may(self, *scopes: str) -> bool:
        """Whether the key has one of these scopes."""
        return bool(self.scopes.intersection(scopes)) or ("admin" in self.scopes and scopes != (OPERATOR,))


@dataclass(frozen=True)
class ApiKey:
    """A key's description; never the secret. `revoked_at` is empty while it works."""

    id: str
    label: str
    scopes: tuple[str, ...]
    created_at: str
    revoked_at: str


def issue(db: Database, master: MasterKey, tenant: str, scopes: Iterable[str], label: str = "") -> str:
    """A new key's token. It is not stored, so a lost key is replaced. "invalid-request" for unknown scopes."""
    with db.write() as connection:
        return _issue(connection, master, tenant, scopes, label)


def issue_first(db: Database, master: MasterKey, tenant: str, label: str = "") -> str | None:
    """The token of an admin key where there was no key at all; None otherwise, also for the second of two."""
    with db.exclusive() as connection:
        if connection.execute(sa.select(api_keys.c.id).limit(1)).first() is not None:
            return None
        return _issue(connection, master, tenant, ("admin",), label)


def check(db: Database, master: MasterKey, token: str) -> Caller:
    """Caller of a token; "unauthorized" for malformed, unknown, wrong and revoked ones alike, after the same work."""
    match = _TOKEN.fullmatch(token)
    key_id, secret = match.groups() if match else ("", "")
    row = db.query(api_keys.select().where(api_keys.c.id == key_id)).one_or_none()
    expected = row.digest if row is not None else ""
    right = master.recognises(expected, PURPOSE, key_id, secret)
    if row is None or not right or row.revoked_at is not None:
        raise Problem("unauthorized", "this API key is not valid", headers={"WWW-Authenticate": "Bearer"})
    return Caller(row.tenant, row.id, frozenset(row.scopes.split()))


def revoke(db: Database, tenant: str, key_id: str) -> None:
    """Revoke a key of this tenant ("not-found" where it has no such key) for good. Twice is once."""
    with db.exclusive() as connection:
        this = (api_keys.c.id == key_id) & (api_keys.c.tenant == tenant)
        row = connection.execute(api_keys.select().where(this)).one_or_none()
        if row is None:
            raise Problem("not-found", f"there is no API key {key_id!r}")
        if row.revoked_at is None:
            connection.execute(api_keys.update().where(this).values(revoked_at=now()))
            audit.append(connection, tenant, "api_key.revoked", {}, key_id)


def list_keys(db: Database, tenant: str) -> list[ApiKey]:
    """Keys of a tenant, revoked ones too, oldest first."""
    query = api_keys.select().where(api_keys.c.tenant == tenant)
    rows = db.query(query.order_by(api_keys.c.created_at, api_keys.c.id)).all()
    return [ApiKey(row.id, row.label, tuple(row.scopes.split()), row.created_at, row.revoked_at or "") for row in rows]


def _issue(connection: sa.Connection, master: MasterKey, tenant: str, scopes: Iterable[str], label: str) -> str:
    check_tenant(tenant)
    wanted = set(scopes)
    if not wanted or not wanted <= set(SCOPES):
        raise Problem("invalid-request", f"scopes are one or more of {', '.join(SCOPES)}; got {wanted or 'none'}")
    ordered = [scope for scope in SCOPES if scope in wanted]
    key_id, secret = secrets.token_hex(8), secrets.token_hex(32)
    row = {"id": key_id, "tenant": tenant, "scopes": " ".join(ordered), "label": label, "created_at": now()}
    connection.execute(api_keys.insert().values(**row, digest=master.mac(PURPOSE, key_id, secret)))
    audit.append(connection, tenant, "api_key.issued", {"scopes": ordered}, key_id)
    return f"mk_{key_id}_{secret}"
