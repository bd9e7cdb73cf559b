"""How much a tenant stores: uploads, and what was made of them. Counted on request, so deleting helps at once."""

import sqlalchemy as sa

from service.core import Service
from service.db import Database
from service.db.schema import assets, uploads
from service.problems import Problem

_BESIDE = 1 << 20
"""Bytes of an asset's preview and entry, which its row does not say."""


def stored_bytes(db: Database, tenant: str) -> int:
    """Bytes of a tenant: uploads, open ones as announced, and assets; an original counts once, however many copies."""

    def measured(name: str) -> sa.ColumnElement[int]:
        report = assets.c.report
        plain = sa.type_coerce(report, sa.JSON) if db.is_sqlite else sa.cast(report, sa.JSON)
        return sa.func.coalesce(sa.cast(plain[name].as_string(), sa.BigInteger), 0)

    mine = assets.c.tenant == tenant
    uploaded = sa.select(uploads.c.sha256).where((uploads.c.tenant == tenant) & (uploads.c.state == "complete"))
    of_uploads = sa.select(sa.func.sum(sa.func.coalesce(uploads.c.size, uploads.c.received)))
    of_copies = sa.select(sa.func.sum(measured("bytes_out") + measured("record_bytes") + _BESIDE)).where(mine)
    originals = sa.select(sa.func.max(measured("bytes_in")).label("bytes")).group_by(assets.c.original_sha256)
    of_originals = sa.select(
        sa.func.sum(originals.where(mine, assets.c.original_sha256.not_in(uploaded)).subquery().c.bytes)
    )
    with db.read() as connection:
        parts = (of_uploads.where(uploads.c.tenant == tenant), of_copies, of_originals)
        return sum(int(connection.execute(part).scalar_one() or 0) for part in parts)


def check_quota(service: Service, tenant: str, more: int) -> None:
    """quota-exceeded where a tenant has no room for so many bytes more."""
    stored, limit = stored_bytes(service.db, tenant), service.settings.tenant_bytes
    if stored + more > limit or stored >= limit:
        text = f"this tenant stores {stored} of {limit} bytes: delete uploads or assets to make room for {more} more"
        raise Problem("quota-exceeded", text, stored=stored, limit=limit)
