"""Commands for the operator: none but `serve` and `init` makes a service, and errors are plain."""

from __future__ import annotations

import json
import sqlite3
import stat
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from service.core import Service
from service.db import Database
from service.settings import Settings
from tests.service.cli.conftest import Mark3dgs
from tests.service.db.test_database import FIRST_VERSION


@pytest.mark.parametrize(
    "command",
    [
        ["apikey", "create"],
        ["apikey", "list"],
        ["apikey", "revoke", "x"],
        ["audit", "verify"],
        ["rotate-signing-key"],
        ["rotate-master-key"],
        ["tenant", "acme", "Acme"],
        ["worker"],
    ],
)
def test_no_command_makes_a_service_where_none_is(mark3dgs: Mark3dgs, tmp_path: Path, command: list[str]) -> None:
    (tmp_path / "data").mkdir()
    code, _, err = mark3dgs(*command)
    assert code == 2
    assert "there is no service in" in err
    assert "mark3dgs init" in err
    assert list((tmp_path / "data").iterdir()) == []
    code, _, err = mark3dgs(*command, DATA_DIR=str(tmp_path / "elsewhere"))
    assert (code, (tmp_path / "elsewhere").exists()) == (2, False)


def test_init_makes_one(mark3dgs: Mark3dgs, tmp_path: Path) -> None:
    code, out, err = mark3dgs("init")
    assert code == 0
    key = tmp_path / "data" / "admin.key"
    assert (key.read_text()[:3], stat.S_IMODE(key.stat().st_mode)) == ("mk_", 0o600)
    assert "mk_" not in err + out, "a log is no place for a key"
    assert str(key) in err
    assert "mark3dgs tenant default" in err
    assert "MARK3DGS_PUBLIC_URL" in err
    assert (
        "MARK3DGS_PUBLIC_URL" not in mark3dgs("init", DATA_DIR=str(tmp_path / "b"), PUBLIC_URL="https://x.example")[2]
    )
    assert mark3dgs("audit", "verify")[0] == 0
    code, out, err = mark3dgs("init")
    assert (code, "API key" in out + err) == (0, False), "twice is once"


def test_a_person_is_shown_the_key(
    mark3dgs: Mark3dgs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    assert "mk_" in mark3dgs("init")[2]
    assert not (tmp_path / "data" / "admin.key").exists()


def test_the_folder_is_nobody_elses(mark3dgs: Mark3dgs, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A folder that others could read is closed to them, and it is said; new files are private, too."""
    data = tmp_path / "data"
    data.mkdir(mode=0o755)
    data.chmod(0o755)
    assert mark3dgs("init")[0] == 0
    assert stat.S_IMODE(data.stat().st_mode) == 0o700
    assert "0755" in caplog.text
    assert all(stat.S_IMODE(path.stat().st_mode) & 0o077 == 0 for path in data.rglob("*") if path.is_file())


def test_a_folder_that_cannot_be_closed_is_refused(
    mark3dgs: Mark3dgs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data").chmod(0o755)

    def refuse(*_: Any) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(Path, "chmod", refuse)
    code, _, err = mark3dgs("init")
    assert (code, "chmod 700" in err) == (2, True)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["apikey", "create", "--scopes", "everything"], "scopes are one or more of"),
        (["apikey", "create", "--scopes", ""], "scopes are one or more of"),
        (["apikey", "create", "--tenant", ""], "a tenant is named by"),
        (["apikey", "create", "--tenant", " acme"], "a tenant is named by"),
        (["apikey", "create", "--tenant", "a\nb"], "a tenant is named by"),
        (["apikey", "create", "--tenant", "x" * 101], "a tenant is named by"),
        (["apikey", "list", "--tenant", "acmee"], "there is no tenant 'acmee'"),
        (["apikey", "revoke", "nothing"], "there is no API key 'nothing'"),
        (["tenant", "acmee", "Acme"], "there is no tenant 'acmee'"),
    ],
)
def test_wrong_usage_is_told_in_a_line(mark3dgs: Mark3dgs, arguments: list[str], text: str) -> None:
    mark3dgs("init")
    code, _, err = mark3dgs(*arguments)
    assert code == 2
    assert text in err
    assert "internal error" not in err
    assert len(err.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("name", "url"),
    [
        ("DATABASE_URL", "nonsense"),
        ("DATABASE_URL", "mysql://u:secret@h/d"),
        ("DATABASE_URL", "postgresql://u:secret@h:port/d"),
        ("BLOB_URL", "nonsense"),
        ("BLOB_URL", "gopher://x"),
    ],
)
def test_addresses_that_are_none(mark3dgs: Mark3dgs, name: str, url: str) -> None:
    code, _, err = mark3dgs("init", **{name: url})
    assert code == 2, err
    assert f"MARK3DGS_{name}" in err
    assert "secret" not in err


def test_a_newer_database(mark3dgs: Mark3dgs, tmp_path: Path) -> None:
    mark3dgs("init")
    database = Database(Settings(data_dir=tmp_path / "data").database())
    with database.write() as connection:
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = '9999'")
    code, _, err = mark3dgs("audit", "verify")
    assert code == 2
    assert "a later version of this program" in err


def test_a_folder_of_the_first_version_is_brought_up_to_date(mark3dgs: Mark3dgs, tmp_path: Path) -> None:
    (tmp_path / "data").mkdir(mode=0o700)
    database = Database(Settings(data_dir=tmp_path / "data").database())
    connection = sqlite3.connect(tmp_path / "data" / "mark3dgs.sqlite")
    connection.executescript(FIRST_VERSION.read_text())
    connection.close()
    assert mark3dgs("init")[0] == 0
    assert mark3dgs("tenant", "default", "Studio Nord")[0] == 0
    with database.read() as connection:
        assert connection.execute(sa.text("SELECT name FROM tenants")).scalar_one() == "Studio Nord"
    assert mark3dgs("audit", "verify")[0] == 0


def test_the_audit_names_a_damaged_file(mark3dgs: Mark3dgs, tmp_path: Path) -> None:
    mark3dgs("init")
    service = Service.open(Settings(data_dir=tmp_path / "data"))
    with service.blobs.new_file() as path:
        path.write_bytes(b"model")
        digest = service.blobs.put(path)
    from service.db.schema import uploads

    row = {"id": "up_1", "tenant": "acme", "created_at": "now", "name": "", "parts": "[]", "state": "complete"}
    with service.db.write() as connection:
        connection.execute(uploads.insert().values(row | {"sha256": digest, "received": 5, "size": 5}))
    service.close()
    assert mark3dgs("audit", "verify")[0] == 0
    (tmp_path / "data" / "blobs" / "blob" / digest[:2] / digest).write_bytes(b"medal")
    code, out, _ = mark3dgs("audit", "verify", "--json")
    assert code == 3
    assert "the upload up_1 (acme)" in json.loads(out)["faults"][0]["text"]


def test_another_master_key(mark3dgs: Mark3dgs, tmp_path: Path) -> None:
    mark3dgs("init")
    before = (tmp_path / "data" / "master.key").read_text()
    assert mark3dgs("rotate-master-key")[0] == 0
    assert (tmp_path / "data" / "master.key").read_text() != before
    assert mark3dgs("rotate-signing-key")[0] == 0


def test_serve_refuses_a_signer_who_can_sign_nothing(mark3dgs: Mark3dgs, tmp_path: Path) -> None:
    """At once, and not at the first download."""
    chain = str(tmp_path / "chain.pem")
    code, _, err = mark3dgs("serve", "--port", "0", CREDENTIALS_CERTIFICATES=chain)
    assert (code, "go together" in err) == (2, True)
    code, _, err = mark3dgs("serve", "--port", "0", CREDENTIALS_CERTIFICATES=chain, CREDENTIALS_KEY=chain)
    assert (code, "cannot be read" in err, "chain.pem" in err) == (2, True, True)


@pytest.mark.parametrize("command", [["serve", "--workers", "0", "--port", "0"], ["worker"], ["apikey", "list"]])
@pytest.mark.parametrize("start", [0, 5000])
def test_a_damaged_database_is_told_plainly(mark3dgs: Mark3dgs, data: Path, start: int, command: list[str]) -> None:
    """Its header, or its pages."""
    for ending in ("-wal", "-shm"):
        (data / f"mark3dgs.sqlite{ending}").unlink(missing_ok=True)
    with (data / "mark3dgs.sqlite").open("r+b") as file:
        file.seek(start)
        file.write(b"\xaa" * (100_000 if start else 100))
    code, _, said = mark3dgs(*command)
    assert code != 0
    assert "the database is damaged" in said
    assert "Traceback" not in said
