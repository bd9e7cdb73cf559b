"""What lists of claims are filtered by: verdict, and names of the files handed in."""

import json

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    """The verdicts of claims that are there follow from their documents; their files' names are not known any more."""
    for name in ("verdict", "names"):
        op.add_column("claims", sa.Column(name, sa.Text, nullable=False, server_default=""))
    claims = sa.table("claims", sa.column("id"), sa.column("document"), sa.column("verdict"))
    connection = op.get_bind()
    for row in connection.execute(sa.select(claims.c.id, claims.c.document)).all():
        verdict = json.loads(row.document).get("verdict", "")
        connection.execute(sa.update(claims).where(claims.c.id == row.id).values(verdict=verdict))
