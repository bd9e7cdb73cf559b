"""One marked scene for the whole flow suite, made by the commands themselves."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from engine.cli.app import run
from tests.scenes import sparse_plant

DATA = Path(__file__).parents[1] / "data"
SCENE = DATA / "plant.splat"


@dataclass(frozen=True)
class Marked:
    """Files of one embedding, and what `embed --json` said."""

    folder: Path
    scene: Path
    key: Path
    record: Path
    model: Path
    report: dict[str, Any]

    def ask(self, capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, dict[str, Any]]:
        """Exit code and JSON of a command."""
        return ask(capsys, *arguments)

    def verify(self, capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, dict[str, Any]]:
        """Exit code and JSON of `verify` with this record and key."""
        return ask(capsys, "verify", *arguments, "--record", self.record, "--key", self.key)


def ask(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, dict[str, Any]]:
    """Run a command with --json: exit code and the object; anything else on stdout or stderr fails."""
    capsys.readouterr()
    code = run([*map(str, arguments), "--json"])
    captured = capsys.readouterr()
    assert captured.err == ""
    return code, json.loads(captured.out)


@pytest.fixture
def key(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    assert ask(capsys, "keygen", tmp_path / "owner.key")[0] == 0
    return tmp_path / "owner.key"


@pytest.fixture(scope="session")
def marked(tmp_path_factory: pytest.TempPathFactory) -> Marked:
    """A third of the shipped scene, marked with the fast profile through the command line; its landmarks are few."""
    folder = tmp_path_factory.mktemp("marked")
    names = ("plant.splat", "owner.key", "plant.record", "marked.ply", "said.json")
    scene, key, record, model, said = (folder / name for name in names)
    scene.write_bytes(sparse_plant(every=3))
    assert run(["keygen", str(key)]) == 0
    # A session fixture has no capsys: the report is taken from a stand-in for stdout.
    import contextlib
    import io

    with contextlib.redirect_stdout(io.StringIO()) as out:
        code = run(
            [
                "embed",
                str(scene),
                str(model),
                "--key",
                str(key),
                "--record",
                str(record),
                "--profile",
                "fast",
                "--set",
                "landmark_views=12",
                "--copy",
                "acme",
                "--message",
                "c0ffee42",
                "--json",
            ]
        )
    said.write_text(out.getvalue())
    assert code == 0, out.getvalue()
    return Marked(folder, scene, key, record, model, json.loads(out.getvalue()))
