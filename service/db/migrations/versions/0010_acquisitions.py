"""Acquisitions: suspects kept as they were found."""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"


def upgrade() -> None:
    """An empty table."""
    names = ("tenant", "api_key", "at", "payload_sha256", "warc_sha256", "created_at")
    op.create_table(
        "acquisitions",
        sa.Column("id", sa.Text, primary_key=True),
        *(sa.Column(name, sa.Text, nullable=False) for name in names),
        *(sa.Column(name, sa.Text) for name in ("url", "upload")),
        *(sa.Column(name, sa.BigInteger, nullable=False) for name in ("bytes", "warc_bytes")),
        sa.Column("timestamp", sa.LargeBinary),
    )
    op.create_index("ix_acquisitions_tenant", "acquisitions", ["tenant"])
