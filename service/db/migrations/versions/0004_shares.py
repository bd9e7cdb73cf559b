"""Reports that are shared for a time."""

import sqlalchemy as sa
from alembic import op

from service.db.schema import key, texts

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    """An empty table."""
    unique = sa.Column("digest", sa.Text, nullable=False, unique=True)
    columns = (*texts("tenant", "created_at", "expires_at"), *texts("claim", index=True), unique)
    op.create_table("shares", *key("id"), *columns)
