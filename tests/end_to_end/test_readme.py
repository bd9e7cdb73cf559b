"""The commands of README.md and docs/GUIDE.md, run as written, give what the page shows.

Every block fenced as ```bash is run, in order, in one folder for each page. Its `tests/data/plant.splat` is an
eighth of the plant, so that a command takes a second or two. `# exit code 3` behind
its last command says what to expect other than 0. A block fenced as ```text right behind it is its output:
every line must come, numbers and names of keys aside, and `...` stands for lines left out.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.scenes import sparse_plant

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"```bash\n(?P<commands>.*?)```(?:\s*```text\n(?P<output>.*?)```)?", re.DOTALL)
EXIT = re.compile(r"# exit code (\d+)")
PLAYED = re.compile(r"^mark3dgs sim ", re.M)
VARIABLE = re.compile(r"\b[0-9a-f]{8,}\b|-?\d([\d.,^]*\d)?(e[+-]?\d+)?")
"""Hexadecimal names and numbers: they differ from run to run and from machine to machine."""


def masked(text: str) -> str:
    """A line with numbers as #, spaces as one; how far an unmarked model comes by chance depends on the key drawn."""
    return " ".join(VARIABLE.sub("#", text).split()).replace("no better than chance", "at most # in #")


PAGES = ("README.md", pytest.param("docs/GUIDE.md", marks=pytest.mark.long))


def blocks(page: str) -> Iterator[re.Match[str]]:
    return BLOCK.finditer((ROOT / page).read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def small_plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped scene, thinned out: merged, its camera was found so roughly that one key in three read no claim."""
    plant = tmp_path_factory.mktemp("plant") / "plant.splat"
    plant.write_bytes(sparse_plant(every=8))
    return plant


@pytest.fixture
def folder(tmp_path: Path, small_plant: Path) -> Path:
    """A clone as far as the commands can see."""
    data = tmp_path / "tests" / "data"
    data.mkdir(parents=True)
    (data / "plant.splat").symlink_to(small_plant)
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    return tmp_path


def test_verdicts_by_chance_read_alike() -> None:
    """The comma behind a number is not part of it."""
    shown = "false claim no better than chance, 2 tries counted (needed: 1 in 2^128)"
    said = "false claim at most 83 in 100, 2 tries counted (needed: 1 in 2^128)"
    assert masked(shown) == masked(said) != masked(said.replace("2 tries", "no tries"))


def test_the_guide_shows_every_command_of_an_owner() -> None:
    text = "".join(block["commands"] for block in blocks("docs/GUIDE.md"))
    for command in (
        "keygen",
        "inspect",
        "convert",
        "embed",
        "verify",
        "render",
        "attack",
        "trace",
        "attest",
        "credentials sign",
        "dispute",
        "sim",
        "config show",
    ):
        assert f"mark3dgs {command}" in text


@pytest.mark.timeout(600)
@pytest.mark.parametrize("page", PAGES)
def test_commands_run_as_written(page: str, folder: Path) -> None:
    """In order: they build on one another."""
    for block in blocks(page):
        if not PLAYED.search(block["commands"]):
            run(block, folder)


@pytest.mark.long
def test_a_whole_life_runs_as_written(folder: Path) -> None:
    """What the simulator plays needs nothing that was made before."""
    played = [block for block in blocks("docs/GUIDE.md") if PLAYED.search(block["commands"])]
    assert played
    for block in played:
        run(block, folder)


def run(block: re.Match[str], folder: Path) -> None:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-e", "-c", block["commands"]],
        cwd=folder,
        capture_output=True,
        text=True,
        env=os.environ | {"PATH": path, "COLUMNS": "100"},
        check=False,
    )
    expected = EXIT.search(block["commands"])
    wanted = int(expected[1]) if expected else 0
    assert done.returncode == wanted, f"{block['commands']}{done.stdout}{done.stderr}"
    said = {masked(line) for line in (done.stdout + done.stderr).splitlines()}
    for line in (block["output"] or "").splitlines():
        assert line.strip() in ("", "...") or masked(line) in said, f"{line!r} not in\n{done.stdout}"
