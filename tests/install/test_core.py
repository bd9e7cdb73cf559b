"""The core needs its own dependencies alone: with all else refused, and installed by itself, it does the main job."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.architecture.tree import ROOT
from tests.install.distributions import PROJECT, beyond_the_core
from tests.scenes import sparse_plant

JOB = Path(__file__).with_name("main_job.py")
MEGABYTES = 650
"""The installed core, without what was there before it and without bytecode."""
HERE = "{}.{}".format(*sys.version_info)
VERSIONS = [line.rpartition(" ")[2] for line in PROJECT["classifiers"] if "Python :: 3." in line]


def do_main_job(python: str, folder: Path, refused: Sequence[str] = (), **environment: str) -> dict[str, Any]:
    """What the core's commands answer, each run by this interpreter."""
    scene = folder / "scene.splat"
    scene.write_bytes(sparse_plant())
    done = run([python, str(JOB), str(scene), str(folder), *refused], folder, **environment)
    answers: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return answers


def run(command: Sequence[str], folder: Path, code: int = 0, **environment: str) -> subprocess.CompletedProcess[str]:
    """A command in an environment without this repository on its path, unless that is given."""
    plain = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONDONTWRITEBYTECODE")}
    done = subprocess.run(
        command, cwd=folder, env=plain | environment, capture_output=True, text=True, timeout=540, check=False
    )
    assert done.returncode == code, done.stdout[-3000:] + done.stderr[-3000:]
    return done


def assert_main_job(answers: dict[str, Any]) -> None:
    """Everything was done, and what needs an extra said so."""
    codes = {name: answer["code"] for name, answer in answers.items()}
    assert codes == dict.fromkeys(codes, 0) | {"verify the original": 3, "refine": 2}
    assert answers["verify a model"]["verdict"] == answers["verify a picture"]["verdict"] == "marked"
    assert answers["verify the original"]["verdict"] == "not_marked"
    assert "mark3dgs[train]" in answers["refine"]["error"]["message"]


@pytest.mark.long
def test_the_main_job_imports_nothing_beyond_the_core(tmp_path: Path) -> None:
    refused = beyond_the_core()
    assert {"torch", "matplotlib", "skimage", "sklearn", "faiss", "fastapi", "httpx"} <= set(refused)
    assert_main_job(do_main_job(sys.executable, tmp_path, refused, PYTHONPATH=str(ROOT)))


def interpreter(version: str) -> str | None:
    """A Python of this version that runs: on the path, or one of pyenv's that is not the chosen one."""
    homes = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    shim = shutil.which("pyenv")
    if shim is not None and not homes.is_dir():
        homes = Path(shim).resolve().parents[1] / "versions"
    found = [shutil.which(f"python{version}"), *sorted(homes.glob(f"{version}*/bin/python{version}"))]
    for each in filter(None, found):
        if subprocess.run([each, "-c", "import venv, ensurepip"], capture_output=True, check=False).returncode == 0:
            return str(each)
    return None


def installed_core(version: str, folder: Path) -> Path:
    """A new environment of this version that has the core alone; skips where version or wheels are missing."""
    python = sys.executable if version == HERE else interpreter(version)
    if python is None:
        pytest.skip(f"there is no Python {version} here")
    run([python, "-m", "venv", str(folder)], folder.parent)
    tree = folder.parent / "tree"
    for name in ("engine", "service"):  # without what an earlier build has left there
        shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tree)
    pip = [str(folder / "bin" / "python"), "-m", "pip", "install", "--disable-pip-version-check", "--no-compile"]
    command = [*pip, "--only-binary=:all:", "-c", str(ROOT / ".ci" / "constraints.txt"), str(tree)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=540, check=False)
    missing = re.search(r"No matching distribution found for (\S+)", done.stderr)
    if missing and version != HERE:
        pytest.skip(f"Python {version} has no wheel of {missing[1]}")
    assert done.returncode == 0, done.stderr[-3000:]
    return folder


def megabytes(packages: Path) -> dict[str, float]:
    """Size on disk of each folder and file that was installed, without pip, setuptools and bytecode."""
    sizes = {}
    for each in packages.iterdir():
        if re.match(r"pip\b|setuptools\b|pkg_resources|_distutils_hack|distutils-|__pycache__", each.name):
            continue
        files = [each] if each.is_file() else [p for p in each.rglob("*") if p.is_file() and p.suffix != ".pyc"]
        sizes[each.name] = sum(p.stat().st_blocks for p in files) * 512 / (1 << 20)
    return sizes


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("version", VERSIONS)
def test_the_core_alone_is_light_and_does_the_main_job(version: str, tmp_path: Path) -> None:
    home = installed_core(version, tmp_path / "venv")
    sizes = megabytes(home / "lib" / f"python{version}" / "site-packages")
    assert sum(sizes.values()) <= MEGABYTES, sorted(sizes.items(), key=lambda item: -item[1])[:12]
    work = tmp_path / "work"
    work.mkdir()
    assert_main_job(do_main_job(str(home / "bin" / "python"), work))
    command = str(home / "bin" / "mark3dgs")
    listed = run([command, "--help"], work).stdout
    assert "Needs mark3dgs[lab]." in listed
    assert "Needs mark3dgs[service]." in listed
    for name, extra in (("attack", "lab"), ("serve", "service")):
        said = run([command, name, "--help"], work, code=2).stderr
        assert f"pip install 'mark3dgs[{extra}]'" in said
    code = "import mark3dgs; print(all(hasattr(mark3dgs, name) for name in mark3dgs.__all__))"
    assert run([str(home / "bin" / "python"), "-c", code], work).stdout == "True\n"
