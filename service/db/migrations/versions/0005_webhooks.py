"""Webhooks, and their pending messages."""

import sqlalchemy as sa
from alembic import op

from service.db.schema import key, number, texts

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    """Empty tables."""
    op.create_table(
        "webhooks",
        *key("id"),
        *texts("tenant", index=True),
        *texts("url", "created_at"),
        number("version"),
        sa.Column("sealed", sa.LargeBinary, nullable=False),
        *texts("last_at", "last_outcome", null=True),
        number("last_status", None),
    )
    op.create_table("deliveries", *key("webhook", "job"), *texts("due_at", index=True), number("tries"))
