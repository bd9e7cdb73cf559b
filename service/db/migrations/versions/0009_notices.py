"""A table of notices to owners whose mark was found in an upload, and a column for the events of each webhook."""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"


def upgrade() -> None:
    """Add both; existing webhooks keep to the end of jobs."""
    names = ("tenant", "asset", "upload", "finding", "created_at")
    texts = [sa.Column(name, sa.Text, nullable=False) for name in names]
    op.create_table("notices", sa.Column("id", sa.Text, primary_key=True), *texts)
    op.create_index("ix_notices_tenant", "notices", ["tenant"])
    op.add_column("webhooks", sa.Column("events", sa.Text, nullable=False, server_default="job.ended"))
