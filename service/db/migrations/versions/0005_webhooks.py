"""Webhooks, and their pending messages."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"


def _text(name: str, null: bool = False) -> sa.Column[str]:
    return sa.Column(name, sa.Text, nullable=null)


def upgrade() -> None:
    """Empty tables."""
    op.create_table(
        "webhooks",
        sa.Column("id", sa.Text, primary_key=True),
        *(_text(name) for name in ("tenant", "url", "created_at")),
        sa.Column("version", sa.BigInteger, nullable=False),
        sa.Column("sealed", sa.LargeBinary, nullable=False),
        *(_text(name, null=True) for name in ("last_at", "last_outcome")),
        sa.Column("last_status", sa.BigInteger, nullable=True),
    )
    op.create_index("ix_webhooks_tenant", "webhooks", ["tenant"])
    keys = [sa.Column(name, sa.Text, primary_key=True) for name in ("webhook", "job")]
    op.create_table("deliveries", *keys, _text("due_at"), sa.Column("tries", sa.BigInteger, nullable=False))
    op.create_index("ix_deliveries_due_at", "deliveries", ["due_at"])
