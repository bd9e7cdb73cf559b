"""Signed manifests of delivered files."""

from alembic import op

from service.db.schema import key, texts

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """An empty table: nothing was signed before."""
    others = texts("signer", "source_sha256", "file_sha256", "sha256", "created_at")
    op.create_table("manifests", *key("id"), *texts("asset", "binding", index=True), *others)
