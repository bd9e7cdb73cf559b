"""Backups by the command: what a copy holds whatever happens meanwhile, and what is refused, leaving nothing behind."""

from __future__ import annotations

import json
import sqlite3
import stat
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from service.backups import manifest, snapshot
from service.core import Service
from service.db.schema import jobs, uploads
from service.settings import DATABASE, JOBS_DATABASE, Settings
from tests.service.cli.conftest import Mark3dgs
from tests.service.cli.folders import UPLOAD, interrupting, put

JOB = {"tenant": "acme", "created_at": "now", "api_key": "", "kind": "embed", "request": "{}", "stage": ""}


def change(folder: Path, *statements: sa.Executable) -> None:
    service = Service.open(Settings(data_dir=folder))
    with service.db.write() as connection:
        for statement in statements:
            connection.execute(statement)
    service.close()


def ask(database: Path, query: str) -> list[Any]:
    with closing(sqlite3.connect(database)) as connection:
        return connection.execute(query).fetchall()


@pytest.fixture
def meanwhile(monkeypatch: pytest.MonkeyPatch) -> Callable[[str, Callable[[], object]], None]:
    """Have something done right after a backup has copied the database of this name."""

    def arrange(name: str, act: Callable[[], object]) -> None:
        real = snapshot._copy_database

        def copy(source: Path, target: Path) -> None:
            real(source, target)
            if source.name == name:
                act()

        monkeypatch.setattr(snapshot, "_copy_database", copy)

    return arrange


def test_there_and_back(mark3dgs: Mark3dgs, data: Path, tmp_path: Path) -> None:
    (data / "certificate.pem").write_text("somebody else's file")
    (data / "catalogue").mkdir()
    code, out, _ = mark3dgs("backup", str(tmp_path / "backup"))
    assert (code, "The log holds" in out) == (0, True)
    held = {path.relative_to(tmp_path / "backup").parts[0] for path in (tmp_path / "backup").rglob("*")}
    assert held == {manifest.NAME, DATABASE, JOBS_DATABASE, "master.key", "certificate.pem", "blobs"}
    files = [path for path in (tmp_path / "backup").rglob("*") if path.is_file()]
    assert all(stat.S_IMODE(path.stat().st_mode) == 0o600 for path in files)
    code, out, _ = mark3dgs("restore", str(tmp_path / "backup"), DATA_DIR=str(tmp_path / "other"))
    assert (code, "The log holds" in out) == (0, True)
    assert (tmp_path / "other" / "master.key").read_text() == (data / "master.key").read_text()
    assert ask(tmp_path / "other" / JOBS_DATABASE, "SELECT name FROM sqlite_master") == [("work",)]
    assert {path.name for path in (tmp_path / "other").iterdir()} == held - {manifest.NAME}
    assert mark3dgs("audit", "verify", DATA_DIR=str(tmp_path / "other"))[0] == 0


def test_a_file_that_comes_between_the_databases(
    mark3dgs: Mark3dgs, data: Path, tmp_path: Path, meanwhile: Callable[..., None]
) -> None:
    meanwhile(JOBS_DATABASE, lambda: put(data, "up_2", b"another model"))
    code, out, _ = mark3dgs("backup", str(tmp_path / "backup"), "--json")
    assert (code, json.loads(out)["audit"]["files"]) == (0, 2)


def test_a_file_that_is_tidied_away_meanwhile(
    mark3dgs: Mark3dgs, data: Path, tmp_path: Path, meanwhile: Callable[..., None]
) -> None:
    """Its row is in the copy, so it must be, too."""
    path = put(data, "up_2", b"another model")
    meanwhile(DATABASE, lambda: (change(data, sa.delete(uploads).where(uploads.c.id == "up_2")), path.unlink()))
    assert mark3dgs("backup", str(tmp_path / "backup"))[0] == 0
    assert (tmp_path / "backup" / path.relative_to(data)).read_bytes() == b"another model"


def test_a_job_that_ends_meanwhile_has_ended(
    mark3dgs: Mark3dgs, data: Path, tmp_path: Path, meanwhile: Callable[..., None]
) -> None:
    """Its row must be no older than what the engine says, or it would be failed as one that ended without a word."""
    change(data, jobs.insert().values(JOB | {"id": "job_1", "state": "running"}))
    meanwhile(JOBS_DATABASE, lambda: change(data, sa.update(jobs).values(state="succeeded")))
    assert mark3dgs("backup", str(tmp_path / "backup"))[0] == 0
    assert ask(tmp_path / "backup" / DATABASE, "SELECT state FROM jobs") == [("succeeded",)]


def test_uploads_under_way_are_left_out(mark3dgs: Mark3dgs, data: Path, tmp_path: Path) -> None:
    change(data, uploads.insert().values(UPLOAD | {"id": "up_2", "state": "open"}))
    part = data / "blobs" / "upload" / "up_2" / "0"
    part.parent.mkdir(parents=True)
    part.write_bytes(b"half")
    assert mark3dgs("backup", str(tmp_path / "backup"))[0] == 0
    assert ask(tmp_path / "backup" / DATABASE, "SELECT id FROM uploads") == [("up_1",)]
    assert not (tmp_path / "backup" / "blobs" / "upload").exists()
    assert len(ask(data / DATABASE, "SELECT id FROM uploads")) == 2, "the service's own are untouched"


def test_a_damaged_file_stops_no_backup(mark3dgs: Mark3dgs, data: Path, tmp_path: Path) -> None:
    put(data, "up_2", b"another model").write_bytes(b"a bit flipped")
    code, out, _ = mark3dgs("backup", str(tmp_path / "backup"))
    assert (code, "the upload up_2 (acme)" in out) == (3, True)
    code, out, _ = mark3dgs("restore", str(tmp_path / "backup"), DATA_DIR=str(tmp_path / "other"))
    assert (code, "the upload up_2 (acme)" in out) == (3, True)
    assert mark3dgs("audit", "verify", DATA_DIR=str(tmp_path / "other"))[0] == 3


def test_without_the_master_key(mark3dgs: Mark3dgs, data: Path, tmp_path: Path) -> None:
    code, out, _ = mark3dgs("backup", str(tmp_path / "backup"), "--without-master-key")
    assert (code, "without the master key" in out) == (0, True)
    assert not (tmp_path / "backup" / "master.key").exists()
    back = ["restore", str(tmp_path / "backup")]
    code, _, err = mark3dgs(*back, DATA_DIR=str(tmp_path / "other"))
    assert (code, "set MARK3DGS_MASTER_KEY" in err) == (2, True)
    code, _, err = mark3dgs(*back, DATA_DIR=str(tmp_path / "other"), MASTER_KEY="00" * 32)
    assert (code, "is not the one that sealed this database" in err) == (2, True)
    assert not (tmp_path / "other").exists()
    key = (data / "master.key").read_text().strip()
    assert mark3dgs(*back, DATA_DIR=str(tmp_path / "other"), MASTER_KEY=key)[0] == 0


@pytest.mark.parametrize(
    ("settings", "text"),
    [({"DATABASE_URL": "postgresql://u@h/d"}, "pg_dump"), ({"BLOB_URL": "s3://bucket/blobs"}, "its own tools")],
)
@pytest.mark.parametrize("command", ["backup", "restore"])
def test_what_lies_elsewhere(
    mark3dgs: Mark3dgs, data: Path, tmp_path: Path, command: str, settings: dict[str, str], text: str
) -> None:
    code, _, err = mark3dgs(command, str(tmp_path / "backup"), **settings)
    assert (code, text in err, "docs/OPERATIONS.md" in err) == (2, True, True)
    assert not (tmp_path / "backup").exists()


def test_where_no_backup_goes(mark3dgs: Mark3dgs, data: Path, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "theirs").write_text("theirs")
    for target, text in ((tmp_path / "full", "it holds 'theirs'"), (data / "backup", "lies in the data folder")):
        code, _, err = mark3dgs("backup", str(target))
        assert (code, text in err) == (2, True), err
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["theirs"]
    assert not (data / "backup").exists()


def test_a_damaged_database(mark3dgs: Mark3dgs, data: Path, tmp_path: Path) -> None:
    (data / JOBS_DATABASE).write_bytes(b"no database" * 1000)
    code, _, err = mark3dgs("backup", str(tmp_path / "backup"))
    assert (code, "cannot be copied" in err, (tmp_path / "backup").exists()) == (2, True, False)


def test_a_service_of_another_version(mark3dgs: Mark3dgs, data: Path, tmp_path: Path) -> None:
    """It is not brought up to date under the feet of the one that runs."""
    change(data, sa.text("UPDATE alembic_version SET version_num = '0001'"))
    code, _, err = mark3dgs("backup", str(tmp_path / "backup"))
    assert (code, "another version" in err) == (2, True)
    assert ask(data / DATABASE, "SELECT version_num FROM alembic_version") == [("0001",)]
    code, _, err = mark3dgs("backup", str(tmp_path / "backup"), DATA_DIR=str(tmp_path / "nowhere"))
    assert (code, "there is no service" in err) == (2, True)
    assert not (tmp_path / "nowhere").exists()


def test_a_master_key_of_another_service(mark3dgs: Mark3dgs, data: Path, tmp_path: Path) -> None:
    (data / "master.key").write_text("00" * 32)
    code, _, err = mark3dgs("backup", str(tmp_path / "backup"))
    assert (code, "is not the one that sealed this database" in err) == (2, True)
    assert not (tmp_path / "backup").exists()


@pytest.mark.parametrize("at", [1, 2])
def test_an_interrupted_backup_leaves_nothing(
    mark3dgs: Mark3dgs, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: int
) -> None:
    monkeypatch.setattr(snapshot, "copy_file", interrupting(manifest.copy_file, at))
    assert mark3dgs("backup", str(tmp_path / "backup"))[0] == 130
    assert not (tmp_path / "backup").exists()
