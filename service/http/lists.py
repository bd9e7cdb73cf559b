"""Lists by cursor: newest first, `limit` at a time, `next` names the last id."""

from typing import Annotated, Any

import sqlalchemy as sa
from fastapi import Query

Limit = Annotated[int, Query(ge=1, le=100, description="Entries a page.")]
After = Annotated[str, Query(max_length=64, description="`next` of the page before.")]


def page(
    connection: sa.Connection,
    table: sa.Table,
    tenant: str,
    limit: int,
    after: str,
    time: str = "created_at",
    where: sa.ColumnElement[bool] | None = None,
) -> tuple[list[Any], str | None]:
    """One page of a tenant's rows, and the cursor of the next page."""
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
