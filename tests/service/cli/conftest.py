"""The command, called in this process; a service to back up, and its backup."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from engine.cli.app import run
from service.settings import JOBS_DATABASE
from tests.service.cli.folders import put

Mark3dgs = Callable[..., tuple[int, str, str]]


@pytest.fixture
def mark3dgs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Mark3dgs:
    """Call the command with a data folder `data`; exit code and what it said."""

    def call(*arguments: str, **settings: str) -> tuple[int, str, str]:
        for name, value in ({"DATA_DIR": str(tmp_path / "data")} | settings).items():
            monkeypatch.setenv(f"MARK3DGS_{name}", value)
        capfd.readouterr()
        code = run(list(arguments))
        said = capfd.readouterr()
        return code, said.out, said.err

    return call


@pytest.fixture
def data(mark3dgs: Mark3dgs, tmp_path: Path) -> Path:
    """A service with one file; the engine of its jobs has tables, too."""
    assert mark3dgs("init")[0] == 0
    put(tmp_path / "data", "up_1", b"model")
    with closing(sqlite3.connect(tmp_path / "data" / JOBS_DATABASE)) as connection:
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("CREATE TABLE work (id)")
    return tmp_path / "data"


@pytest.fixture
def backup(mark3dgs: Mark3dgs, data: Path, tmp_path: Path) -> Path:
    assert mark3dgs("backup", str(tmp_path / "backup"))[0] == 0
    return tmp_path / "backup"
