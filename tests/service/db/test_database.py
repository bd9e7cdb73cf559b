"""The tables: migrations make what the schema says; writes are durable; an outage is a problem with a name."""

from __future__ import annotations

from pathlib import Path

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext

from service.clock import now
from service.db import Database, holding, metadata
from service.db.schema import claims, uploads, usage, workers
from service.problems import Problem
from service.settings import Settings

FIRST_VERSION = Path(__file__).parent / "first_version.sql"
VERSIONS = Path(__file__).parents[3] / "service" / "db" / "migrations" / "versions"


@pytest.fixture
def db(tmp_path: Path) -> Database:
    made = Database(f"sqlite:///{tmp_path / 'test.sqlite'}")
    made.migrate()
    return made


def test_migrations_make_what_the_schema_says(db: Database) -> None:
    db.migrate()  # a second time changes nothing
    with db.engine.connect() as connection:
        context = MigrationContext.configure(connection)
        assert compare_metadata(context, metadata) == []
        assert context.get_current_revision() == max(path.stem[:4] for path in VERSIONS.glob("0*.py"))


def first_version(database: Database) -> None:
    """Make the tables as the first version did, with a claim of then."""
    text = FIRST_VERSION.read_text().split("\n", 1)[1]
    if not database.is_sqlite:
        text = text.replace("BLOB", "BYTEA").replace('"index" INTEGER', '"index" BIGINT')
    with database.write() as connection:
        for statement in filter(str.strip, text.split(";")):
            connection.exec_driver_sql(statement)
        old = {"id": "cl_1", "tenant": "t", "job": "j", "asset": None, "document": '{"verdict": "not_marked"}'}
        columns = ", ".join([*old, "jws", "pictures", "created_at"])
        values = ", ".join([*(f":{name}" for name in old), "'a.b.c'", "'{}'", "'2026'"])
        connection.execute(sa.text(f"INSERT INTO claims ({columns}) VALUES ({values})"), old)
        for state in ("open", "complete"):
            row = f"'up_{state}', 't', '2026', 'a.ply', '[[0, 5], [5, 5]]', '{state}', 10"
            columns = "id, tenant, created_at, name, parts, state, received"
            connection.execute(sa.text(f"INSERT INTO uploads ({columns}) VALUES ({row})"))


@pytest.mark.parametrize("kind", ["sqlite", "postgres"])
def test_an_earlier_database_becomes_what_the_schema_says(
    kind: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    url = f"sqlite:///{tmp_path / 'old.sqlite'}"
    if kind == "postgres":
        url = Settings(database_url=request.getfixturevalue("postgres").new_database("first")).database()
    old = Database(url)
    first_version(old)
    old.migrate()
    with old.engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), metadata) == []
        assert connection.execute(sa.select(uploads.c.id, uploads.c.parts)).all() == [("up_complete", "[]")]
        row = connection.execute(sa.select(claims)).one()
    assert (row.verdict, row.names, row.jws) == ("not_marked", "", "a.b.c")
    old.close()


def test_searching_knows_letters_beyond_ascii(db: Database) -> None:
    with db.write() as connection:
        for subject in ("MÖBEL_1%", "mobel"):
            connection.execute(usage.insert().values(subject=subject, window="w", count=1))
    with db.read() as connection:
        for text, expected in (("möbel", ["MÖBEL_1%"]), ("L_", ["MÖBEL_1%"]), ("%", ["MÖBEL_1%"]), ("o_e", [])):
            found = connection.execute(sa.select(usage.c.subject).where(holding(text, usage.c.subject))).scalars()
            assert list(found) == expected, text


def test_durable_and_one_writer(db: Database) -> None:
    with db.read() as connection:
        assert connection.exec_driver_sql("PRAGMA journal_mode").scalar() == "wal"
        assert connection.exec_driver_sql("PRAGMA synchronous").scalar() == 2  # FULL
    with db.write() as connection:
        connection.execute(usage.insert().values(subject="a", window=now(), count=1))
        with db.read() as other:
            assert other.execute(sa.select(sa.func.count()).select_from(usage)).scalar_one() == 0


def test_a_block_that_raises_leaves_nothing(db: Database) -> None:
    def stopped() -> None:
        with db.write() as connection:
            connection.execute(usage.insert().values(subject="a", window="w", count=1))
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        stopped()
    with db.read() as connection:
        assert connection.execute(sa.select(usage)).first() is None


def test_an_outage_is_a_503(tmp_path: Path) -> None:
    gone = Database(f"sqlite:///{tmp_path / 'nowhere' / 'x.sqlite'}")
    with pytest.raises(Problem) as caught, gone.read() as connection:
        connection.execute(sa.select(workers))
    assert (caught.value.kind, caught.value.status) == ("unavailable", 503)
    assert "Retry-After" in caught.value.headers


def test_a_broken_statement_stays_a_bug(db: Database) -> None:
    row = usage.insert().values(subject="a", window="w", count=1)
    with db.write() as connection:
        connection.execute(row)
    with db.write() as connection, pytest.raises(sa.exc.IntegrityError):
        connection.execute(row)
