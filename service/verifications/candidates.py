"""Which records a suspect is held against, and how often that may be asked."""

from typing import Any

import sqlalchemy as sa

from service.core import Service
from service.db.schema import assets
from service.http.budgets import spend


def asset_exists(core: Service, tenant: str, asset_id: str) -> bool:
    """Whether this tenant has that asset."""
    mine = (assets.c.id == asset_id) & (assets.c.tenant == tenant)
    with core.db.read() as connection:
        return connection.execute(sa.select(assets.c.id).where(mine)).first() is not None


def rows_to_try(core: Service, tenant: str, asset_id: str | None) -> list[Any]:
    """The asset that was named, or all of the tenant's, newest first."""
    query = sa.select(assets).where(assets.c.tenant == tenant).order_by(assets.c.registered_at.desc())
    if asset_id is not None:
        query = query.where(assets.c.id == asset_id)
    with core.db.read() as connection:
        return list(connection.execute(query))


def spend_subject(core: Service, asset_id: str) -> None:
    """Count one verification of a suspect that derives from an asset: all such suspects are near duplicates, and a
    detector asked often enough about slight changes of one model tells how to remove its mark."""
    spend(
        core.db,
        f"subject:{asset_id}",
        core.settings.subject_verifies_per_day,
        24,
        "verifications of suspects that derive from one asset",
    )
