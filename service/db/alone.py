"""One writer at a time where the order of writers matters."""

import sqlalchemy as sa

_LOCK = 0x6D61726B  # "mark"


def alone(connection: sa.Connection) -> None:
    """Wait for other transactions that asked for this, and keep them waiting until this one ends.

    On SQLite every writing transaction is alone already. Ask before reading what the write depends on: on
    PostgreSQL a statement sees what was committed before it began.
    """
    if connection.dialect.name == "postgresql":
        connection.execute(sa.select(sa.func.pg_advisory_xact_lock(_LOCK)))
