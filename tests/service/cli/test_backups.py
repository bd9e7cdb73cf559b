"""Backups by the command: what a copy holds whatever happens meanwhile, and what is refused, leaving nothing behind."""

from __future__ import annotations

import json
import os
import sqlite3
import stat
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from service.backups import manifest, taking
from service.core import Service
from service.db.schema import jobs, uploads
from service.settings import DATABASE, JOBS_DATABASE, Settings
from tests.service.cli.conftest import Mark3dgs

UPLOAD = {"tenant": "acme", "created_at": "now", "name": "", "parts": "[]", "received": 5, "size": 5}
JOB = {"tenant": "acme", "created_at": "now", "api_key": "", "kind": "embed", "request": "{}", "stage": ""}


def put(folder: Path, name: str, content: bytes) -> Path:
    """A finished upload in a data folder; where its file lies."""
    service = Service.open(Settings(data_dir=folder))
    with service.blobs.new_file() as path:
        path.write_bytes(content)
        digest = service.blobs.put(path)
    with service.db.write() as connection:
        connection.execute(uploads.insert().values(UPLOAD | {"id": name, "state": "complete", "sha256": digest}))
    service.close()
    return folder / "blobs" / "blob" / digest[:2] / digest


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
def data(mark3dgs: Mark3dgs, tmp_path: Path) -> Path:
    """A service with one file; the engine of its jobs has tables, too."""
    assert mark3dgs("init")[0] == 0
    put(tmp_path / "data", "up_1", b"model")
    with closing(sqlite3.connect(tmp_path / "data" / JOBS_DATABASE)) as connection:
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("CREATE TABLE work (id)")
    return tmp_path / "data"


@pytest.fixture
def meanwhile(monkeypatch: pytest.MonkeyPatch) -> Callable[[str, Callable[[], object]], None]:
    """Have something done right after a backup has copied the database of this name."""

    def arrange(name: str, act: Callable[[], object]) -> None:
        real = taking._copy_database

        def copy(source: Path, target: Path) -> None:
            real(source, target)
            if source.name == name:
                act()

        monkeypatch.setattr(taking, "_copy_database", copy)

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


@pytest.fixture
def backup(mark3dgs: Mark3dgs, data: Path, tmp_path: Path) -> Path:
    assert mark3dgs("backup", str(tmp_path / "backup"))[0] == 0
    return tmp_path / "backup"


def _blob(folder: Path) -> Path:
    (found,) = (folder / "blobs" / "blob").glob("*/*")
    return found


def _listed(folder: Path, **changes: Any) -> None:
    plain = json.loads((folder / manifest.NAME).read_text())
    (folder / manifest.NAME).write_text(json.dumps(plain | changes))


DAMAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "broken off": (lambda folder: (folder / manifest.NAME).unlink(), "broken off"),
    "list cut short": (lambda folder: os.truncate(folder / manifest.NAME, 100), "is damaged"),
    "list of nothing": (lambda folder: (folder / manifest.NAME).write_text("[]"), "is damaged"),
    "files of nothing": (lambda folder: _listed(folder, files=[1]), "is damaged"),
    "later format": (lambda folder: _listed(folder, format=2), "a later version"),
    "out of the folder": (lambda folder: _listed(folder, files={"../x": {"bytes": 1, "sha256": ""}}), "'../x'"),
    "file gone": (lambda folder: _blob(folder).unlink(), "is missing"),
    "file altered": (lambda folder: _blob(folder).write_bytes(b"medal"), "is not the file"),
    "database altered": (lambda folder: os.truncate(folder / DATABASE, 4096), "is not the file"),
    "key altered": (lambda folder: (folder / "master.key").write_text("00" * 32), "is not the file"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_backup(mark3dgs: Mark3dgs, backup: Path, tmp_path: Path, damage: str) -> None:
    hurt, text = DAMAGES[damage]
    hurt(backup)
    code, _, err = mark3dgs("restore", str(backup), DATA_DIR=str(tmp_path / "other"))
    assert code == 2, err
    assert text in err
    assert len(err.strip().splitlines()) == 1
    assert not (tmp_path / "other").exists()


def test_a_folder_that_is_not_empty(mark3dgs: Mark3dgs, backup: Path, data: Path, tmp_path: Path) -> None:
    before = {path: path.read_bytes() for path in data.rglob("*") if path.is_file()}
    code, _, err = mark3dgs("restore", str(backup))
    assert (code, "is not empty" in err) == (2, True)
    assert {path: path.read_bytes() for path in data.rglob("*") if path.is_file()} == before
    container = tmp_path / "other"
    (container / "numba").mkdir(parents=True)
    (container / "scratch").mkdir()
    assert mark3dgs("restore", str(backup), DATA_DIR=str(container))[0] == 0


def interrupting(real: Callable[..., Any], at: int) -> Callable[..., Any]:
    """A function during whose call of this number somebody presses Ctrl-C."""
    calls: list[None] = []

    def call(*arguments: Any) -> Any:
        calls.append(None)
        if len(calls) == at:
            raise KeyboardInterrupt
        return real(*arguments)

    return call


@pytest.mark.parametrize("at", [1, 2])
def test_an_interrupted_backup_leaves_nothing(
    mark3dgs: Mark3dgs, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: int
) -> None:
    monkeypatch.setattr(taking, "copy_file", interrupting(manifest.copy_file, at))
    assert mark3dgs("backup", str(tmp_path / "backup"))[0] == 130
    assert not (tmp_path / "backup").exists()


@pytest.mark.parametrize("name", ["service.backups.restoring.copy_file", "os.replace"])
def test_an_interrupted_restore_leaves_nothing(
    mark3dgs: Mark3dgs, backup: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """While files are copied, and while they are put in their places."""
    (tmp_path / "other").mkdir()
    with monkeypatch.context() as patch:
        patch.setattr(name, interrupting(os.replace if name == "os.replace" else manifest.copy_file, 3))
        assert mark3dgs("restore", str(backup), DATA_DIR=str(tmp_path / "other"))[0] == 130
    assert list((tmp_path / "other").iterdir()) == []
    assert mark3dgs("restore", str(backup), DATA_DIR=str(tmp_path / "other"))[0] == 0


def test_a_killed_restore_is_no_service(
    mark3dgs: Mark3dgs, backup: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody tidies up after a kill: what is half there must neither be served nor taken for an empty folder."""
    other = tmp_path / "other"
    with monkeypatch.context() as patch:
        patch.setattr("os.replace", interrupting(os.replace, 3))
        patch.setattr("shutil.rmtree", lambda path: None)
        patch.setattr(Path, "unlink", lambda path: None)
        patch.setattr(Path, "rmdir", lambda path: None)
        assert mark3dgs("restore", str(backup), DATA_DIR=str(other))[0] == 130
    assert (other / "restoring").exists()
    for command, text in ((["init"], "broken off"), (["restore", str(backup)], "is not empty")):
        code, _, err = mark3dgs(*command, DATA_DIR=str(other))
        assert (code, text in err) == (2, True)
    assert not (other / DATABASE).exists()
