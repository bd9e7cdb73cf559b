"""One database: short reads, writes that are durable when they return, and a tenant's rows by id or by page."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVarTuple

import sqlalchemy as sa
from sqlalchemy import event
from sqlalchemy.exc import DBAPIError

from engine.errors import InputError
from service.db.schema import facts, metadata
from service.problems import Problem

if TYPE_CHECKING:
    from alembic.config import Config

Ts = TypeVarTuple("Ts")
_log = logging.getLogger(__name__)
_LOCK = 0x6D61726B  # "mark"
_REFUSED = re.compile(
    r"(?:FATAL|fe_sendauth): *"
    r"(.*(?:authentication failed|does not exist|no password|pg_hba\.conf|permission denied|not permitted).*)"
)
BUSY_MILLISECONDS = 15_000
POSTGRES_CONNECT = {
    "connect_timeout": 3,
    # A server that vanished without a word is noticed within seconds, not after the kernel's quarter of an hour.
    "keepalives_idle": 5,
    "keepalives_interval": 2,
    "keepalives_count": 3,
    "tcp_user_timeout": 10_000,
}
"""libpq's parameters of every connection."""


class Database:
    """Connections to our tables, at a SQLAlchemy URL.

    On SQLite: WAL, synchronous FULL, and every write begins IMMEDIATE, so that there is one writer at a time and
    no deadlock between readers that want to write.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self.is_sqlite = url.startswith("sqlite")
        try:
            self.engine = self._engine(url)
        except (sa.exc.ArgumentError, sa.exc.NoSuchModuleError, ValueError):  # without the URL: a password is in it
            raise InputError("MARK3DGS_DATABASE_URL is no address of a PostgreSQL database: postgresql://...") from None

    def _engine(self, url: str) -> sa.Engine:
        if self.is_sqlite:
            engine = sa.create_engine(url, connect_args={"check_same_thread": False})
            event.listen(engine, "connect", _set_up_sqlite)
            event.listen(engine, "begin", _begin_immediate)
            return engine
        if not url.startswith("postgresql"):
            raise ValueError(url)
        return sa.create_engine(url, pool_pre_ping=True, pool_timeout=5, connect_args=dict(POSTGRES_CONNECT))

    @property
    def exists(self) -> bool:
        """Whether there are tables of this service; makes none."""
        if self.is_sqlite and not Path(str(self.engine.url.database)).exists():
            return False
        with self.read() as connection:
            return sa.inspect(connection).has_table("alembic_version")

    @property
    def is_current(self) -> bool:
        """Whether the tables are those of this version of the program."""
        from alembic.script import ScriptDirectory

        with self.read() as connection:
            found = connection.execute(sa.text("SELECT version_num FROM alembic_version")).scalar_one_or_none()
        return found == ScriptDirectory.from_config(_migrations()).get_current_head()

    @contextmanager
    def read(self) -> Iterator[sa.Connection]:
        """A connection for reading; sees what was committed."""
        with _as_problems(), self.engine.connect() as connection:
            yield connection.execution_options(isolation_level="AUTOCOMMIT")

    @contextmanager
    def write(self) -> Iterator[sa.Connection]:
        """A transaction; committed when the block ends, rolled back when it raises."""
        with _as_problems(), self.engine.begin() as connection:
            yield connection

    @contextmanager
    def exclusive(self) -> Iterator[sa.Connection]:
        """As `write`, with one such transaction at a time: what it reads stays true until it ends."""
        with self.write() as connection:
            take_write_lock(connection)
            yield connection

    def query(self, statement: sa.Select[*Ts]) -> sa.Result[*Ts]:
        """The rows of one statement, fetched whole."""
        with self.read() as connection:
            return connection.execute(statement).freeze()()

    def change(self, statement: sa.UpdateBase) -> int:
        """Do one statement in a transaction of its own; how many rows it changed."""
        with self.write() as connection:
            return connection.execute(statement).rowcount

    def migrate(self) -> None:
        """Bring the tables up to this version of the program: an empty database is made as the schema says, an older
        one is changed step by step."""
        from alembic import command
        from alembic.util.exc import CommandError

        config = _migrations()
        with self.write() as connection:
            take_write_lock(connection)
            config.attributes["connection"] = connection
            if sa.inspect(connection).has_table("alembic_version"):
                try:
                    command.upgrade(config, "head")
                except CommandError:  # it knows no such step
                    text = "a later version of this program has changed this database: use that one"
                    raise InputError(text) from None
            else:
                metadata.create_all(connection)
                command.stamp(config, "head")

    def close(self) -> None:
        """Give the connections back."""
        self.engine.dispose()


def take_write_lock(connection: sa.Connection) -> None:
    """Wait for other transactions that hold this lock, and keep the next waiting until this one ends.

    On SQLite only one transaction writes at a time anyway. Take it before reading what the write depends on: on
    PostgreSQL a statement sees what was committed before it began.
    """
    if connection.dialect.name == "postgresql":
        connection.execute(sa.select(sa.func.pg_advisory_xact_lock(_LOCK)))


def server_of(url: str) -> str:
    """Host and port of a PostgreSQL URL: never its password."""
    address = sa.make_url(url)
    return f"{address.host or 'localhost'}:{address.port or 5432}"


def refusal(problem: Problem) -> str:
    """What a server said that answers and will never accept these settings; "" where waiting may help.

    libpq gives no code of a failed connection, only a text, in the server's language: one that is not known here is
    waited out.
    """
    found = _REFUSED.search(str(problem.__cause__))
    return found[1] if found else ""


def own(db: Database, table: sa.Table, tenant: str, row_id: str) -> Any:
    """The row with this id; not-found for other tenants' too."""
    mine = (table.c.id == row_id) & (table.c.tenant == tenant)
    with db.read() as connection:
        row = connection.execute(sa.select(table).where(mine)).first()
    if row is None:
        raise missing(table, row_id)
    return row


def missing(table: sa.Table, row_id: str) -> Problem:
    """The error for a row that does not exist, or is not visible."""
    return Problem("not-found", f"there is no {table.name.removesuffix('s')} {row_id!r}")


def fact(connection: sa.Connection, name: str) -> str | None:
    """What holds for this database as a whole, by its name; None where it was never set."""
    return connection.execute(sa.select(facts.c.value).where(facts.c.name == name)).scalar_one_or_none()


def page(
    connection: sa.Connection,
    table: sa.Table,
    tenant: str,
    limit: int,
    after: str,
    time: str = "created_at",
    where: sa.ColumnElement[bool] | None = None,
) -> tuple[list[Any], str | None]:
    """At most `limit` rows after the one with the id `after` (invalid-request if there is none), and the cursor of the
    next page: its last id."""
    moment, key = table.c[time], table.c.id
    query = sa.select(table).where(table.c.tenant == tenant).order_by(moment.desc(), key.desc()).limit(limit + 1)
    if where is not None:
        query = query.where(where)
    if after:
        last = sa.select(moment, key).where((key == after) & (table.c.tenant == tenant))
        found = connection.execute(last).first()
        if found is None:  # another tenant's, too
            raise Problem("invalid-request", f"after: {after!r} is not a valid cursor of this list")
        query = query.where((moment < found[0]) | ((moment == found[0]) & (key < found[1])))
    rows = list(connection.execute(query))
    return rows[:limit], rows[limit - 1].id if len(rows) > limit else None


def holding(text: str, *columns: sa.ColumnElement[str]) -> sa.ColumnElement[bool]:
    """Rows of which one of the columns contains a text, upper and lower case alike."""
    return sa.or_(*(column.icontains(text, autoescape=True) for column in columns))


def _migrations() -> Config:
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent / "migrations"))
    return config


@contextmanager
def _as_problems() -> Iterator[None]:
    """A database that does not answer, or is damaged, is a 503, a full disk a 507; a broken statement stays a bug of
    ours."""
    try:
        yield
    except DBAPIError as error:
        text = str(error.orig).lower()
        if "disk is full" in text or "no space" in text:
            raise Problem("storage-full", "the database's disk is full") from error
        if "malformed" in text or "not a database" in text:  # SQLite's words
            _log.error("the database is damaged: %s", error.orig)
            detail = "the database is damaged: its operator restores a backup (docs/OPERATIONS.md)"
            raise Problem("unavailable", detail, headers={"Retry-After": "300"}) from error
        if isinstance(error, (sa.exc.OperationalError, sa.exc.InterfaceError)):
            raise Problem("unavailable", "the database does not answer", headers={"Retry-After": "5"}) from error
        raise
    except sa.exc.TimeoutError as error:
        raise Problem("unavailable", "the database is busy", headers={"Retry-After": "5"}) from error


def _set_up_sqlite(connection: Any, _: Any) -> None:
    connection.isolation_level = None  # SQLAlchemy's own BEGIN, below, instead of the driver's
    cursor = connection.cursor()
    for pragma in (
        "journal_mode=WAL",
        "synchronous=FULL",
        "secure_delete=ON",  # an erased owner key leaves no bytes behind
        f"busy_timeout={BUSY_MILLISECONDS}",
    ):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()
    # SQLite's own knows no letters but those of ASCII, and a search is to find "Möbel" under "MÖBEL".
    connection.create_function("lower", 1, lambda text: text and str(text).lower(), deterministic=True)


def _begin_immediate(connection: sa.Connection) -> None:
    if connection.get_execution_options().get("isolation_level") != "AUTOCOMMIT":
        connection.exec_driver_sql("BEGIN IMMEDIATE")
