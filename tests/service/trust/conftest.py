"""A fresh service's tables on both databases, and its master key."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.db import Database
from service.settings import Settings
from service.trust.master import MasterKey

_numbers = itertools.count()


@pytest.fixture(params=["sqlite", "postgres"])
def settings(request: pytest.FixtureRequest, tmp_path: Path) -> Settings:
    url = ""
    if request.param == "postgres":
        url = request.getfixturevalue("postgres").new_database(f"trust{next(_numbers)}")
    folder = tmp_path / "data"
    folder.mkdir()
    return Settings(data_dir=folder, database_url=url)


@pytest.fixture
def db(settings: Settings) -> Iterator[Database]:
    database = Database(settings.database())
    database.migrate()
    yield database
    database.close()


@pytest.fixture
def master(settings: Settings, db: Database) -> MasterKey:
    return MasterKey.open(settings, db)
