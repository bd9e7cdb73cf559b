"""The folder of compiled kernels: which one is taken, what it costs where there is none, and what is removed."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from engine.kernels import kernel_cache
from engine.kernels.machine_code import Code

DAY = 86400.0
CODE = Code("f", ["i64"], [], False, [], b"machine\ncode")
ROOT = Path(__file__).parents[2]


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine of its own: a package, a home and temporary files, all empty; nothing found out before counts."""
    for name in ("engine", "home", "tmp"):
        (tmp_path / name).mkdir()
    monkeypatch.setattr(kernel_cache, "_ENGINE", tmp_path / "engine")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "MARK3DGS_WARNED_CACHE"):
        monkeypatch.setenv(name, "")  # so that it is as before afterwards
        monkeypatch.delenv(name)
    for name in ("folders", "folder", "remove_unused"):
        monkeypatch.setattr(kernel_cache, name, functools.cache(getattr(kernel_cache, name).__wrapped__))
    return tmp_path


def block(place: Path) -> None:
    """Make a folder impossible, for root too."""
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text("a file where a folder should be")


def test_the_package_comes_first(places: Path) -> None:
    assert kernel_cache.folder() == places / "engine" / "__pycache__" / "kernels"
    assert not list((places / "tmp").iterdir())


def test_a_folder_that_is_given_is_the_only_one(places: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(places / "given"))
    assert kernel_cache.folders() == (places / "given" / "kernels",)
    assert kernel_cache.folder() == places / "given" / "kernels"


def test_a_read_only_package_leaves_the_users_cache(places: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    block(places / "engine" / "__pycache__")
    assert kernel_cache.folder() == places / "home" / ".cache" / "mark3dgs" / "kernels"
    kernel_cache.folders.cache_clear()
    kernel_cache.folder.cache_clear()
    monkeypatch.setenv("XDG_CACHE_HOME", str(places / "own"))
    assert kernel_cache.folder() == places / "own" / "mark3dgs" / "kernels"


def test_kernels_of_a_package_that_is_read_only_are_found(places: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kernel_cache.keep("k", "text", "<f8", CODE)
    package = places / "engine" / "__pycache__" / "kernels"
    monkeypatch.setattr(kernel_cache, "_can_write", lambda place: place != package)
    kernel_cache.folders.cache_clear()
    kernel_cache.folder.cache_clear()
    assert kernel_cache.folder() != package
    assert kernel_cache.find("k", "text", "<f8") == CODE
    assert os.stat(next(package.iterdir())).st_mode & 0o044 == 0o044, "another user cannot read it"


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="no numbers of users")
@pytest.mark.parametrize("home", ["", "missing"])
def test_without_a_home_there_are_temporary_files(places: Path, monkeypatch: pytest.MonkeyPatch, home: str) -> None:
    """As with `docker run --user`: no home, or one that cannot be made."""
    block(places / "engine" / "__pycache__")
    if home:
        block(places / "missing")
        monkeypatch.setenv("HOME", str(places / "missing"))
    else:
        monkeypatch.delenv("HOME")
        monkeypatch.setattr("os.path.expanduser", lambda path: path)  # as for a user that the system does not know
    own = places / "tmp" / f"mark3dgs-{os.getuid()}"
    assert kernel_cache.folder() == own
    assert own.stat().st_mode & 0o777 == 0o700
    own.chmod(0o777)  # another user could have put code there
    kernel_cache.folders.cache_clear()
    kernel_cache.folder.cache_clear()
    assert kernel_cache.folder() is None
    assert own not in kernel_cache.folders()


def test_another_users_folder_is_no_cache(places: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    block(places / "engine" / "__pycache__")
    block(places / "home" / ".cache")
    (places / "elsewhere").mkdir(mode=0o700)
    (places / "tmp" / f"mark3dgs-{os.getuid()}").symlink_to(places / "elsewhere")
    assert kernel_cache.folder() is None


COMMAND = """
import subprocess, sys
import numpy as np
from engine.kernels.jit import kernel
def f(x):
    return x + 1
def g(x):
    return np.ones(3) + x
assert kernel(f)(1) == 2 and kernel(f)(1.0) == 2.0 and kernel(allocates=True)(g)(1.0).sum() == 6.0
if len(sys.argv) == 1:
    subprocess.run([sys.executable, __file__, "again"], check=True)
"""


def test_a_folder_that_cannot_be_used_is_named_once(tmp_path: Path) -> None:
    """Not by each process of a command; kernels run nevertheless."""
    block(tmp_path / "file")
    (tmp_path / "command.py").write_text(COMMAND)
    environment = {k: v for k, v in os.environ.items() if not k.startswith("MARK3DGS_WARNED")}
    environment |= {"NUMBA_CACHE_DIR": str(tmp_path / "file"), "PYTHONPATH": str(ROOT)}
    run = [sys.executable, str(tmp_path / "command.py")]
    done = subprocess.run(run, env=environment, capture_output=True, text=True, check=True)
    (line,) = done.stderr.splitlines()
    assert str(tmp_path / "file") in line
    assert "NUMBA_CACHE_DIR" in line


def test_other_facts_are_other_files(monkeypatch: pytest.MonkeyPatch) -> None:
    first = kernel_cache.path_of("a.b", "kernel", "text", "<f8")
    assert first == kernel_cache.path_of("a.b", "kernel", "text", "<f8")
    assert first != kernel_cache.path_of("a.b", "kernel", "other", "<f8")
    for name, other in (("processor", lambda: ("other", "+avx")), ("compiler", lambda: ["0"])):
        with monkeypatch.context() as patch:
            patch.setattr(kernel_cache, name, other)
            assert kernel_cache.path_of("a.b", "kernel", "text", "<f8") != first


def age(path: Path, days: float) -> float:
    """Last used so long ago."""
    when = time.time() - days * DAY
    os.utime(path, (when, when))
    return path.stat().st_mtime


def test_what_is_used_counts_as_used_once_a_day(places: Path) -> None:
    kernel_cache.keep("k", "text", "<f8", CODE)
    (file,) = (places / "engine" / "__pycache__" / "kernels").iterdir()
    before = age(file, 0.5)
    assert kernel_cache.find("k", "text", "<f8") == CODE
    assert file.stat().st_mtime == before
    age(file, 1.5)
    assert kernel_cache.find("k", "text", "<f8") == CODE
    assert time.time() - file.stat().st_mtime < DAY / 2


def test_what_nobody_uses_is_removed(places: Path) -> None:
    """When something is written, by whichever version; and a folder of numba's with what is in it."""
    place = kernel_cache.folder()
    assert place is not None
    old, lately = place / "old-1.kernel", place / "lately-1.kernel"
    numbas = [place / "old-2.numba", place / "lately-2.numba"]
    for each in numbas:
        each.mkdir()
        (each / "index").write_bytes(b"")
    for each in (old, lately):
        each.write_bytes(b"")
    other = place / "README"
    other.write_bytes(b"")
    for each in (old, other, numbas[0]):
        age(each, 31.0)
    for each in (lately, numbas[1]):
        age(each, 29.0)
    kernel_cache.keep("k", "text", "<f8", CODE)
    left = {each.name for each in place.iterdir()}
    assert left == {"lately-1.kernel", "lately-2.numba", "README", kernel_cache.path_of("k", "kernel", "text", "<f8")}


REMOVE = """
import sys
from pathlib import Path
from engine.kernels import kernel_cache
place = Path(sys.argv[1])
kernel_cache.folder = lambda: place
sys.stdin.readline()
kernel_cache.remove_unused()
"""


def test_several_processes_remove_side_by_side(tmp_path: Path) -> None:
    for number in range(300):
        (tmp_path / f"k-{number}.kernel").write_bytes(b"")
        age(tmp_path / f"k-{number}.kernel", 40.0 if number % 3 else 1.0)
    run = [sys.executable, "-c", REMOVE, str(tmp_path)]
    several = [subprocess.Popen(run, stdin=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT) for _ in range(3)]
    for each in several:
        assert each.communicate(b"\n")[1] == b""
        assert each.returncode == 0
    assert {int(path.stem[2:]) for path in tmp_path.iterdir()} == set(range(0, 300, 3))
