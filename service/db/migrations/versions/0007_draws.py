"""Time stamps that draw a part of records' plans."""

import sqlalchemy as sa
from alembic import op

from service.db.schema import key, texts

revision = "0007"
down_revision = "0006"


def upgrade() -> None:
    """An empty table: a service drew by itself before."""
    token = sa.Column("token", sa.LargeBinary, nullable=False)
    op.create_table("draws", *key("request"), token, *texts("created_at"))
