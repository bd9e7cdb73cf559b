"""Uploads belong to the API key that made them; their parts are named, with length and digest."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"


def upgrade() -> None:
    """Uploads under way start again: of their parts no digest is known. Complete ones are seen by `admin` alone."""
    op.add_column("uploads", sa.Column("api_key", sa.Text, nullable=False, server_default=""))
    op.execute("DELETE FROM uploads WHERE state = 'open'")
    op.execute("UPDATE uploads SET parts = '[]'")
