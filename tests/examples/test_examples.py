"""The programs of docs/examples, and that of README.md, run as written on a small model."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from engine.formats import read_model, write_model
from engine.lab.sim.attacks import model_attack
from tests.service import serving
from tests.service.serving import ROOT

PROGRAMS = ROOT / "docs" / "examples"
PATH = f"{ROOT}{os.pathsep}{ROOT / 'service' / 'installed'}"


def run(program: str, *arguments: str | Path, api_key: str = "", folder: Path = PROGRAMS) -> str:
    """What a program prints that lies in the folder, its working directory; the test fails if the program does."""
    environment = os.environ | {"PYTHONPATH": PATH, "MARK3DGS_API_KEY": api_key}
    command = [sys.executable, str(folder / program), *map(str, arguments)]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped scene, merged to 15,000 Gaussians."""
    path = tmp_path_factory.mktemp("plant") / "plant.ply"
    whole = read_model(ROOT / "tests" / "data" / "plant.splat").model
    write_model(model_attack("merge").apply(whole, 0.132), path)
    return path


@pytest.fixture
def installed() -> None:
    """Skips where the package `mark3dgs` does not hold the engine's names."""
    if not hasattr(importlib.import_module("mark3dgs"), "embed"):
        pytest.skip("the package mark3dgs has no engine here")


@pytest.mark.usefixtures("installed")
def test_a_piece_is_found_and_the_original_is_not(plant: Path, tmp_path: Path) -> None:
    """The program draws its key, and how firmly so small a model excludes the mark depends on that; never claimed."""
    piece, original = run("mark_and_verify.py", plant, tmp_path).splitlines()
    assert piece.startswith("piece: marked,")
    assert re.match(r"original: (not_marked|inconclusive),", original), original


@pytest.mark.usefixtures("installed")
def test_the_copy_that_leaked_is_named_alone(plant: Path) -> None:
    assert run("trace_copies.py", plant) == "named: bolt\n"


@pytest.mark.usefixtures("installed")
def test_the_program_of_the_readme_runs(plant: Path, tmp_path: Path) -> None:
    (program,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "tests" / "data").mkdir(parents=True)
    (tmp_path / "tests" / "data" / "plant.splat").symlink_to(plant)
    (tmp_path / "program.py").write_text(program)
    assert run("program.py", folder=tmp_path).startswith("marked -")


@pytest.mark.long
def test_the_service_finds_the_copy_it_marked(plant: Path, tmp_path: Path) -> None:
    served = serving.start(tmp_path)
    try:
        said = run("service_client.py", served.address, plant, tmp_path, api_key=served.api_key)
    finally:
        served.stop()
    assert re.match(r"marked: asset as_\w+, false claim at most 10\^-\d{3,}\n", said), said
    assert (tmp_path / "report.html").read_text().startswith("<!doctype html>")
