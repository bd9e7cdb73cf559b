"""What owners publish of an asset's credentials; and the statement of rights in a signed file."""

import sqlalchemy as sa
from alembic import op

from service.db.schema import key, texts

revision = "0011"
down_revision = "0010"


def upgrade() -> None:
    """An empty table: no asset is found by its content until its owner says so. Signed files state no rights."""
    by_content = sa.Column("by_content", sa.Boolean, nullable=False)
    op.create_table("published", *key("asset"), by_content, *texts("rights"))
    op.add_column("manifests", sa.Column("rights", sa.Text, nullable=False, server_default=""))
