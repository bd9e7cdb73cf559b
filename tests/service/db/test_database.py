"""The tables: migrations make what the schema says; writes are durable; an outage is a problem with a name."""

from __future__ import annotations

from pathlib import Path

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext

from service.clock import now
from service.db import Database, metadata
from service.db.schema import manifests, tenants, usage, workers
from service.problems import Problem

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


def test_an_earlier_versions_database_becomes_what_the_schema_says(tmp_path: Path) -> None:
    older = Database(f"sqlite:///{tmp_path / 'test.sqlite'}")
    with older.engine.begin() as connection:
        metadata.create_all(
            connection, tables=[each for each in metadata.sorted_tables if each not in (tenants, manifests)]
        )
        connection.exec_driver_sql("CREATE TABLE alembic_version (version_num VARCHAR(32) NOT NULL)")
        connection.exec_driver_sql("INSERT INTO alembic_version VALUES ('0001')")
    older.migrate()
    with older.engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), metadata) == []


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
