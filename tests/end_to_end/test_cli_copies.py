"""Several copies in one command: each recipient's own mark, the same bytes as from a command of its own."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.end_to_end.conftest import DATA, ask

Capsys = pytest.CaptureFixture[str]
SMALL = DATA / "train_1000.ply"
NAMES = ("acme", "globex")


def embed(capsys: Capsys, folder: Path, key: Path, out: str, *copies: str) -> tuple[int, dict[str, object]]:
    named = [part for copy in copies for part in ("--copy", copy)]
    files = (folder / f"{out}.ply", "--key", key, "--record", folder / f"{out}.record")
    return ask(capsys, "embed", SMALL, *files, "--profile", "fast", *named)


@pytest.mark.long
def test_each_recipient_has_a_copy_and_a_record(key: Path, capsys: Capsys, tmp_path: Path) -> None:
    code, said = embed(capsys, tmp_path, key, "{copy}", *NAMES)
    assert code == 0
    first, second = said["copies"]
    assert (first["copy"], second["copy"]) == NAMES
    assert first["message"] == second["message"], "the owner's layer is shared"
    assert "landmarks" in first["seconds_by_stage"]
    assert "landmarks" not in second["seconds_by_stage"], "made twice"
    for name in NAMES:
        files = (tmp_path / f"{name}.ply", "--record", tmp_path / f"{name}.record", "--key", key)
        code, claim = ask(capsys, "verify", *files, "--route", "model")
        assert (code, claim["copy"]) == (0, name)
    code, other = ask(capsys, "verify", tmp_path / "acme.ply", "--record", tmp_path / "globex.record", "--key", key)
    assert (code, other["copy_named"]) == (0, False), "the owner's, and another's copy"
    code, _ = embed(capsys, tmp_path, key, "alone", "globex")
    assert code == 0
    assert (tmp_path / "alone.ply").read_bytes() == (tmp_path / "globex.ply").read_bytes()
    assert (tmp_path / "alone.record").read_bytes() == (tmp_path / "globex.record").read_bytes()


@pytest.mark.parametrize(
    ("out", "copies", "says"),
    [
        ("one", NAMES, "several copies need {copy}"),
        ("{copy}", ("acme", "acme"), "copy 'acme' is given twice"),
        ("{copy}", ("acme", "../up"), "copy '../up' cannot stand in a file's name"),
        ("{copy}", ("..",), "copy '..' cannot stand in a file's name"),
        ("{copy}", (), "copy '' cannot stand in a file's name"),
    ],
)
def test_names_that_cannot_be_told_apart_are_refused(
    key: Path, capsys: Capsys, tmp_path: Path, out: str, copies: tuple[str, ...], says: str
) -> None:
    code, said = embed(capsys, tmp_path, key, out, *copies)
    assert code == 2
    assert says in str(said["error"]["message"])  # type: ignore[index]
    assert [path.name for path in tmp_path.iterdir()] == ["owner.key"]
