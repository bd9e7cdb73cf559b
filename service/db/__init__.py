"""Our tables: SQLite by default, PostgreSQL by URL, the same code. Start at `schema`; all writes go by `Database`."""

from service.db.database import Database, fact, holding, missing, own, page, take_write_lock
from service.db.schema import metadata

__all__ = ["Database", "fact", "holding", "metadata", "missing", "own", "page", "take_write_lock"]
