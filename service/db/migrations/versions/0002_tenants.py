"""Names of tenants for people."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"


def upgrade() -> None:
    """An empty table: a tenant without a name is called by its id."""
    op.create_table("tenants", sa.Column("id", sa.Text, primary_key=True), sa.Column("name", sa.Text, nullable=False))
