"""Break one line at a time in a copy of the tree, and count how often a test notices: `make mutants`."""

from __future__ import annotations

import argparse
import importlib
import multiprocessing
import os
import shutil
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.architecture.tree import ROOT, tracked_files
from tests.mutants.table import mutated, read_table

SECONDS = 600
"""A mutant that keeps its tests busy for longer has been noticed."""
WANTED = 0.9
HEAVY = ("tests.conftest", "numba", "numpy", "scipy.spatial", "scipy.ndimage", "cv2", "skimage.metrics", "torch")
"""Loaded once, before each mutant's process is forked off; nothing of the tree itself is."""


def main() -> int:
    """Run the table; 1 where the score of a part is below what is wanted."""
    parser = argparse.ArgumentParser(prog="make mutants")
    parser.add_argument(
        "--only", action="append", help="only mutants whose file or line holds this text; may be repeated"
    )
    only = parser.parse_args().only or [""]
    chosen = [mutant for mutant in read_table() if any(text in f"{mutant.path} {mutant.line}" for text in only)]
    for name in HEAVY:
        importlib.import_module(name)
    fates: dict[str, Counter[str]] = defaultdict(Counter)
    with _copy_of_the_tree() as root:
        changes = [mutated(root, mutant) for mutant in chosen]  # a line that is not there ends it before it starts
        for tests in dict.fromkeys(mutant.tests for mutant in chosen):
            if _outcome(root, tests) != pytest.ExitCode.OK:
                raise SystemExit(f"{' '.join(tests)} fail without any mutation")
        for mutant, (path, text) in zip(chosen, changes, strict=True):
            began = time.monotonic()
            with _changed(root / path, text):
                fate = "survived" if _outcome(root, mutant.tests) == pytest.ExitCode.OK else "killed"
            fates[mutant.part][fate] += 1
            _say(f"{fate:8} {time.monotonic() - began:5.0f} s  {path}: {mutant.line}  ->  {mutant.changed}")
    _say("")
    for part, count in fates.items():
        _say(f"{part}: {count['killed']} of {count.total()} killed, {count['killed'] / count.total():.0%}")
    return int(any(count["killed"] < WANTED * count.total() for count in fates.values()))


@contextmanager
def _copy_of_the_tree() -> Iterator[Path]:
    """Tracked files and the kernels compiled from them."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        for path in tracked_files():
            (Path(folder) / path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / path, Path(folder) / path)
        for kernel in (ROOT / "engine").rglob("__pycache__/*.nb[ic]"):
            target = Path(folder) / kernel.relative_to(ROOT)
            target.parent.mkdir(exist_ok=True)
            shutil.copy2(kernel, target)
        yield Path(folder)


@contextmanager
def _changed(path: Path, text: str) -> Iterator[None]:
    """The file with another text; after it the old one again, of its old date, which numba's cache goes by."""
    original, dates = path.read_bytes(), path.stat()
    path.write_text(text, encoding="utf-8")
    yield
    path.write_bytes(original)
    os.utime(path, ns=(dates.st_atime_ns, dates.st_mtime_ns))


def _outcome(root: Path, tests: tuple[str, ...]) -> int:
    """Exit code of pytest in a process of its own; -1 where it took too long."""
    process = multiprocessing.get_context("fork").Process(target=_test, args=(root, tests))
    process.start()
    process.join(SECONDS)
    if process.is_alive():
        process.kill()
        process.join()
        return -1
    if process.exitcode not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        raise SystemExit(f"{' '.join(tests)}: pytest ended with {process.exitcode}")
    return int(process.exitcode)


def _test(root: Path, tests: tuple[str, ...]) -> None:
    """In the forked process: the modules of this tree make room for those of the copy."""
    os.chdir(root)
    sys.path[:] = [str(root), *(path for path in sys.path if path and Path(path).resolve() != ROOT)]
    for name in [name for name in sys.modules if name.split(".")[0] in ("engine", "service", "tests")]:
        del sys.modules[name]
    sys.dont_write_bytecode = True
    os.environ |= {"PYTHONPATH": str(root), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    os._exit(pytest.main(["-x", "-m", "not docker", "-p", "no:cacheprovider", "-p", "pytest_timeout", *tests]))


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
