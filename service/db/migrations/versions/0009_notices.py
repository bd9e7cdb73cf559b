"""A table of notices to owners whose mark was found in an upload, and a column for the events of each webhook."""

import sqlalchemy as sa
from alembic import op

from service.db.schema import key, texts

revision = "0009"
down_revision = "0008"


def upgrade() -> None:
    """Add both; existing webhooks keep to the end of jobs."""
    others = texts("asset", "upload", "finding", "created_at")
    op.create_table("notices", *key("id"), *texts("tenant", index=True), *others)
    op.add_column("webhooks", sa.Column("events", sa.Text, nullable=False, server_default="job.ended"))
