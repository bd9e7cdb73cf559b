"""Webhooks of tenants, and the secrets that their messages are signed with: sealed, shown once."""

import secrets
from typing import Any

import sqlalchemy as sa

from service.clock import now
from service.db import Database, missing
from service.db.schema import ENDED, FOUND, deliveries, webhooks
from service.problems import Problem
from service.trust import audit
from service.trust.master import VERSION, MasterKey, bind

SECRET_BYTES = 32


def add(
    db: Database, master: MasterKey, tenant: str, url: str, host: str, most: int, events: str = f"{ENDED} {FOUND}"
) -> tuple[str, Any]:
    """A new webhook's secret and row; budget-exceeded where the tenant has `most`.

    The log keeps the host alone: an address may have a secret of the receiver's in it.
    """
    secret, name, made = f"whs_{secrets.token_hex(SECRET_BYTES)}", f"wh_{secrets.token_hex(12)}", now()
    sealed = master.seal(secret.encode(), _bound(tenant, name, VERSION))
    with db.exclusive() as connection:
        mine = sa.select(sa.func.count()).select_from(webhooks).where(webhooks.c.tenant == tenant)
        if connection.execute(mine).scalar_one() >= most:
            raise Problem("budget-exceeded", f"a tenant has at most {most} webhooks: delete one")
        values = {"id": name, "tenant": tenant, "url": url, "created_at": made, "version": VERSION, "sealed": sealed}
        values["events"] = events
        connection.execute(webhooks.insert().values(values))
        audit.append(connection, tenant, "webhook.made", {"host": host}, name)
        row = connection.execute(sa.select(webhooks).where(webhooks.c.id == name)).one()
    return secret, row


def delete(db: Database, tenant: str, name: str) -> None:
    """Delete a webhook and its pending messages."""
    with db.exclusive() as connection:
        this = (webhooks.c.id == name) & (webhooks.c.tenant == tenant)
        if connection.execute(sa.delete(webhooks).where(this)).rowcount == 0:
            raise missing(webhooks, name)
        connection.execute(sa.delete(deliveries).where(deliveries.c.webhook == name))
        audit.append(connection, tenant, "webhook.deleted", {}, name)


def secret_of(master: MasterKey, row: Any) -> str:
    """What a webhook's messages are signed with."""
    return master.unseal(row.sealed, secret_seal(row)).decode()


def secret_seal(row: Any) -> bytes:
    """What the seal of a row's secret is bound to."""
    return _bound(row.tenant, row.id, row.version)


def _bound(tenant: str, name: str, version: int) -> bytes:
    return bind("webhook", tenant, name, version)
