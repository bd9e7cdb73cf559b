"""The first tables. Nothing is to be done: a new database is made from the schema and stamped with the last version,
so migrations run only on databases that some earlier version has made."""

revision = "0001"
down_revision = None


def upgrade() -> None:
    """The tables are there."""
