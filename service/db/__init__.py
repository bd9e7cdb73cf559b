"""Our tables: SQLite by default, PostgreSQL by URL, the same code."""

from service.db.database import Database, alone
from service.db.schema import metadata

__all__ = ["Database", "alone", "metadata"]
