"""Restoring by the command: damaged backups are refused, and what is broken off leaves nothing that could be served."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from service.backups import manifest
from service.settings import DATABASE
from tests.service.cli.conftest import Mark3dgs
from tests.service.cli.folders import interrupting


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
    "no tables": (lambda folder: _listed(folder, files={}), "lists no mark3dgs.sqlite"),
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


@pytest.mark.parametrize("name", ["service.backups.restoration.copy_file", "os.replace"])
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
