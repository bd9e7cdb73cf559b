"""Signed manifests of delivered files."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """An empty table: nothing was signed before."""
    names = ("asset", "binding", "signer", "source_sha256", "file_sha256", "sha256", "created_at")
    columns = [sa.Column(name, sa.Text, nullable=False) for name in names]
    op.create_table("manifests", sa.Column("id", sa.Text, primary_key=True), *columns)
    for name in ("asset", "binding"):
        op.create_index(f"ix_manifests_{name}", "manifests", [name])
