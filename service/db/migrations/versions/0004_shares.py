"""Reports that are shared for a time."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    """An empty table."""
    texts = [sa.Column(name, sa.Text, nullable=False) for name in ("tenant", "claim", "created_at", "expires_at")]
    unique = sa.Column("digest", sa.Text, nullable=False, unique=True)
    op.create_table("shares", sa.Column("id", sa.Text, primary_key=True), *texts, unique)
    op.create_index("ix_shares_claim", "shares", ["claim"])
