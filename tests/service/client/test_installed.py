"""The client as its users get it: under its name from wheel and editable install, and alone, with nothing but httpx."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from service import client
from tests.service.serving import ROOT

LOOK = """
import importlib, json, pkgutil, site, sys
sys.path[:0] = [sys.argv[1]]
site.addsitedir(sys.argv[1])
sys.path.append(sys.argv[2])
import mark3dgs.client as named
import service.client as home
for module in pkgutil.iter_modules(home.__path__, "service.client."):
    importlib.import_module(module.name)
same = all(getattr(named, name) is getattr(home, name) for name in home.__all__)
print(json.dumps([named.__file__, named.__all__, same, sorted(sys.modules)]))
"""


def look(folder: Path) -> tuple[str, set[str]]:
    """Where the client was found and what it brought in, by an interpreter that knows this folder and httpx only."""
    command = [sys.executable, "-S", "-I", "-c", LOOK, str(folder), sysconfig.get_path("purelib")]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    file, names, same, modules = json.loads(done.stdout)
    assert (names, same) == (client.__all__, True)
    return file, set(modules)


def test_it_stands_alone(tmp_path: Path) -> None:
    (tmp_path / "service").mkdir()
    shutil.copy(ROOT / "service" / "__init__.py", tmp_path / "service")
    shutil.copytree(ROOT / "service" / "client", tmp_path / "service" / "client")
    shutil.copytree(ROOT / "service" / "installed" / "mark3dgs", tmp_path / "mark3dgs")
    file, modules = look(tmp_path)
    assert Path(file).is_relative_to(tmp_path)
    ours = {name for name in modules if name.split(".")[0] in ("service", "engine")}
    assert all(name == "service" or name.startswith("service.client") for name in ours)
    assert "httpx" in modules
    assert not modules & {"fastapi", "numpy", "pydantic", "sqlalchemy"}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["wheel", "editable"])
def test_it_is_installed_under_its_name(tmp_path: Path, kind: str) -> None:
    pytest.importorskip("setuptools", minversion="77")
    tree, out = tmp_path / "tree", tmp_path / "out"
    for name in ("engine", "service"):
        left_out = shutil.ignore_patterns("__pycache__", "viewer", "docs")
        shutil.copytree(ROOT / name, tree / name, ignore=left_out)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tree)
    code = f"from setuptools import build_meta; print(build_meta.build_{kind}({str(tmp_path)!r}))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tree, capture_output=True, text=True, timeout=240, check=False
    )
    assert done.returncode == 0, done.stderr
    with zipfile.ZipFile(tmp_path / done.stdout.splitlines()[-1]) as wheel:
        wheel.extractall(out)
    file, _ = look(out)
    home = out if kind == "wheel" else tree / "service" / "installed"
    assert Path(file) == home / "mark3dgs" / "client.py"
    if kind == "wheel":
        assert (out / "mark3dgs" / "py.typed").is_file()
        assert (out / "service" / "py.typed").is_file()
        assert not (out / "service" / "installed").exists()
        assert (out / "engine" / "lab" / "sim" / "scenario").is_dir()
