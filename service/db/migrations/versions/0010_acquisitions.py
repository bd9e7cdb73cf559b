"""Acquisitions: suspects kept as they were found."""

import sqlalchemy as sa
from alembic import op

from service.db.schema import key, number, texts

revision = "0010"
down_revision = "0009"


def upgrade() -> None:
    """An empty table."""
    op.create_table(
        "acquisitions",
        *key("id"),
        *texts("tenant", index=True),
        *texts("api_key", "at", "payload_sha256", "warc_sha256", "created_at"),
        *texts("url", "upload", null=True),
        number("bytes"),
        number("warc_bytes"),
        sa.Column("timestamp", sa.LargeBinary),
    )
