"""Our tables: SQLite by default, PostgreSQL by URL, the same code. Start at `schema`; all writes go by `Database`."""

from service.db.database import Database, alone, holding, missing, own, page
from service.db.schema import metadata

__all__ = ["Database", "alone", "holding", "metadata", "missing", "own", "page"]
