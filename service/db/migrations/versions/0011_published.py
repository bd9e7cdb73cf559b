"""What owners publish of an asset's credentials; and the statement of rights in a signed file."""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"


def upgrade() -> None:
    """An empty table: no asset is found by its content until its owner says so. Signed files state no rights."""
    op.create_table(
        "published",
        sa.Column("asset", sa.Text, primary_key=True),
        sa.Column("by_content", sa.Boolean, nullable=False),
        sa.Column("rights", sa.Text, nullable=False),
    )
    op.add_column("manifests", sa.Column("rights", sa.Text, nullable=False, server_default=""))
