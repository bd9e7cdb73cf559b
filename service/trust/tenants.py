"""Tenants: their ids, as operators choose them, and what people call them."""

import sqlalchemy as sa

from service.db import Database
from service.db.schema import api_keys, tenants
from service.problems import Problem
from service.trust import audit

MOST_CHARACTERS = 100
FIRST_TENANT = "default"
"""Tenant of the first API key; not a name."""


def check_tenant(tenant: str) -> None:
    """invalid-request unless an id is 1 to 100 printable characters without blanks around them."""
    if not (tenant and tenant.isprintable() and tenant == tenant.strip() and len(tenant) <= MOST_CHARACTERS):
        text = f"a tenant is named by 1 to {MOST_CHARACTERS} printable characters without blanks around: {tenant!r}"
        raise Problem("invalid-request", text)


def display_name(connection: sa.Connection, tenant: str) -> str:
    """What people call a tenant; its id where none was set."""
    found = connection.execute(sa.select(tenants.c.name).where(tenants.c.id == tenant)).scalar_one_or_none()
    return str(found or tenant)


def name_tenant(db: Database, tenant: str, name: str) -> None:
    """Claims from now on call a tenant so; "not-found" where it has no API key. The log says who was called what."""
    check_tenant(name)
    with db.exclusive() as connection:
        if connection.execute(sa.select(api_keys.c.id).where(api_keys.c.tenant == tenant).limit(1)).first() is None:
            raise Problem("not-found", f"there is no tenant {tenant!r}: it has no API key")
        connection.execute(sa.delete(tenants).where(tenants.c.id == tenant))
        connection.execute(tenants.insert().values(id=tenant, name=name))
        audit.append(connection, tenant, "tenant.named", {"name": name}, tenant)
