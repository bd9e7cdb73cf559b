"""Break one line at a time in a copy of the tree, and count how often a test notices: `make mutants`."""

from __future__ import annotations

import argparse
import importlib
import json
import multiprocessing
import os
import resource
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from tests.architecture.tree import ROOT, tracked_files
from tests.mutants.table import Mutant, find, mutated, read_table

SECONDS = 600
"""Of processor time. A mutant that keeps its tests busy for longer has been noticed; so has one that a test awaits in
vain, which pytest ends."""
WANTED = 0.9
HEAVY = ("tests.conftest", "numba", "numpy", "scipy.spatial", "scipy.ndimage", "cv2", "skimage.metrics", "torch")
"""Loaded once, before each mutant's process is forked off; nothing of the tree itself is."""
SEEN = "mutants_seen.json"


def main() -> int:
    """Run the table; 1 where the score of a part is below what is wanted."""
    parser = argparse.ArgumentParser(prog="make mutants")
    parser.add_argument(
        "--only", action="append", help="only mutants whose file or line holds this text; may be repeated"
    )
    only = parser.parse_args().only or [""]
    groups: dict[tuple[str, ...], list[Mutant]] = defaultdict(list)
    for mutant in read_table():
        if any(text in f"{mutant.path} {mutant.line}" for text in only):
            groups[mutant.tests].append(mutant)
    for name in HEAVY:
        importlib.import_module(name)
    fates: dict[str, Counter[str]] = defaultdict(Counter)
    with _copy_of_the_tree() as root:
        for mutants in groups.values():  # a line that is not there ends it before it starts
            _ = [find(root, mutant) for mutant in mutants]
        for tests, mutants in groups.items():
            for mutant, fate, seconds in _fates(root, tests, mutants):
                fates[mutant.part][fate] += 1
                _say(f"{fate:8} {seconds:5.0f} s  {mutant.path}: {mutant.line}  ->  {mutant.changed}")
    _say("")
    for part, count in fates.items():
        _say(f"{part}: {count['killed']} of {count.total()} killed, {count['killed'] / count.total():.0%}")
    return int(any(count["killed"] < WANTED * count.total() for count in fates.values()))


def _fates(root: Path, tests: tuple[str, ...], mutants: list[Mutant]) -> Iterator[tuple[Mutant, str, float]]:
    """Each mutant with its fate and the processor time of its tests: first those that run its line, then the others."""
    watch = _Watch({(str(root / path), line + 1) for path, line in (find(root, mutant) for mutant in mutants)})
    if _outcome(root, tests, watch) != pytest.ExitCode.OK:
        raise SystemExit(f"{' '.join(tests)} fail without any mutation")
    seen = json.loads((root / SEEN).read_text())
    for mutant in mutants:
        path, line = find(root, mutant)
        near = {test for test, (_, lines) in seen.items() if f"{root / path}:{line + 1}" in lines}
        began = _processor_seconds()
        with _changed(root / path, mutated(root, mutant)[1]):
            parts = [part for part in (near, seen.keys() - near) if part]
            passed = all(_outcome(root, tests, _Choice({test: seen[test][0] for test in part})) == 0 for part in parts)
        yield mutant, "survived" if passed else "killed", _processor_seconds() - began


class _Watch:
    """Plugin of pytest that writes to `SEEN` the seconds of each test, and which of some lines it runs."""

    def __init__(self, lines: set[tuple[str, int]]) -> None:
        self._lines, self._files = lines, {path for path, _ in lines}
        self._seen: dict[str, tuple[float, list[str]]] = {}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        began, lines = time.process_time(), set()

        def trace(frame: FrameType, event: str, _: object) -> Any:
            if frame.f_code.co_filename not in self._files:
                return None
            if event == "line" and (frame.f_code.co_filename, frame.f_lineno) in self._lines:
                lines.add(f"{frame.f_code.co_filename}:{frame.f_lineno}")
            return trace

        threading.settrace(trace)
        sys.settrace(trace)
        try:
            return (yield)
        finally:
            sys.settrace(None)
            self._seen[item.nodeid] = time.process_time() - began, sorted(lines)

    def pytest_sessionfinish(self) -> None:
        Path(SEEN).write_text(json.dumps(self._seen))


class _Choice:
    """Plugin of pytest that plays some of the tests, given with their seconds: whole files, the quickest first."""

    def __init__(self, tests: dict[str, float]) -> None:
        self._tests = tests

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        seconds: Counter[Path] = Counter()
        items[:] = [item for item in items if item.nodeid in self._tests]
        for item in items:
            seconds[item.path] += self._tests[item.nodeid]  # type: ignore[assignment]
        items.sort(key=lambda item: seconds[item.path])


def _processor_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@contextmanager
def _copy_of_the_tree() -> Iterator[Path]:
    """Tracked files and the kernels compiled from them."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        for path in tracked_files():
            (Path(folder) / path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / path, Path(folder) / path)
        compiled = Path("engine", "__pycache__", "kernels")
        if (ROOT / compiled).is_dir():
            shutil.copytree(ROOT / compiled, Path(folder) / compiled)
        yield Path(folder)


@contextmanager
def _changed(path: Path, text: str) -> Iterator[None]:
    """The file with another text; after it the old one again, of its old date, which numba's cache goes by."""
    original, dates = path.read_bytes(), path.stat()
    path.write_text(text, encoding="utf-8")
    yield
    path.write_bytes(original)
    os.utime(path, ns=(dates.st_atime_ns, dates.st_mtime_ns))


def _outcome(root: Path, tests: tuple[str, ...], plugin: object) -> int:
    """Exit code of pytest in a process of its own; negative where it took too long."""
    process = multiprocessing.get_context("fork").Process(target=_test, args=(root, tests, plugin))
    process.start()
    process.join()
    if process.exitcode not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED, -signal.SIGXCPU):
        raise SystemExit(f"{' '.join(tests)}: pytest ended with {process.exitcode}")
    return int(process.exitcode)


def _test(root: Path, tests: tuple[str, ...], plugin: object) -> None:
    """In the forked process: the modules of this tree make room for those of the copy."""
    os.chdir(root)
    sys.path[:] = [str(root), *(path for path in sys.path if path and Path(path).resolve() != ROOT)]
    for name in [name for name in sys.modules if name.split(".")[0] in ("engine", "service", "tests")]:
        del sys.modules[name]
    sys.dont_write_bytecode = True
    os.environ |= {"PYTHONPATH": str(root), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 5))
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    chosen = ("-x", "-m", "not docker", "-p", "no:cacheprovider", "-p", "pytest_timeout", "--timeout", "1800")
    os._exit(pytest.main([*chosen, *tests], plugins=[plugin]))


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
