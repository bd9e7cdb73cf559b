"""A tenant's rows: one by its id, or a page at a time, newest first."""

from typing import Any

import sqlalchemy as sa

from service.db.database import Database
from service.problems import Problem


def own(db: Database, table: sa.Table, tenant: str, row_id: str) -> Any:
    """The row with this id; not-found for other tenants' too."""
    mine = (table.c.id == row_id) & (table.c.tenant == tenant)
    with db.read() as connection:
        row = connection.execute(sa.select(table).where(mine)).first()
    if row is None:
        raise Problem("not-found", f"there is no {table.name.removesuffix('s')} {row_id!r}")
    return row


def page(
    connection: sa.Connection,
    table: sa.Table,
    tenant: str,
    limit: int,
    after: str,
    time: str = "created_at",
    where: sa.ColumnElement[bool] | None = None,
) -> tuple[list[Any], str | None]:
    """At most `limit` rows after the one with the id `after`, and the cursor of the next page: its last id."""
    moment, key = table.c[time], table.c.id
    query = sa.select(table).where(table.c.tenant == tenant).order_by(moment.desc(), key.desc()).limit(limit + 1)
    if where is not None:
        query = query.where(where)
    if after:
        last = sa.select(moment, key).where((key == after) & (table.c.tenant == tenant))
        found = connection.execute(last).first()
        if found is None:
            return [], None
        query = query.where((moment < found[0]) | ((moment == found[0]) & (key < found[1])))
    rows = list(connection.execute(query))
    return rows[:limit], rows[limit - 1].id if len(rows) > limit else None
