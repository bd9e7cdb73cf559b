"""Names of tenants for people."""

from alembic import op

from service.db.schema import key, texts

revision = "0002"
down_revision = "0001"


def upgrade() -> None:
    """An empty table: a tenant without a name is called by its id."""
    op.create_table("tenants", *key("id"), *texts("name"))
