"""Compiled kernels: the first run on a machine compiles them, and says so. `python -m
engine.cli.kernel_progress` does nothing else, for all of them."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from engine.cli.console import Console, Progress

if TYPE_CHECKING:
    from engine.flows.warmup.kernel_warmup import Work

_ENGINE = Path(__file__).parents[1]


def prepare_kernels(console: Console, progress: Progress, work: Work = "embed") -> float:
    """Compile the kernels of some work where they are not there yet, in so many seconds, and say what is awaited.

    That they are there is known by a stamp, without loading one: an empty file of this Python, these sources and this
    processor. With a stamp that is out of date the user waits without this note; nothing else goes wrong."""
    from engine.kernels import kernel_cache

    began = time.perf_counter()
    if all(kernel_cache.read(_stamp(each)) is None for each in (work, "everything")):
        from engine.flows.warmup.kernel_warmup import expected_seconds, warm_up

        often = "once per machine" if kernel_cache.folder() else "at every command, as they cannot be kept"
        said = f"compiling kernels, {often}: about {expected_seconds(work):.0f} s on free, quick cores"
        warm_up(work, lambda fraction: progress("compile", fraction), compiling=lambda: console.note(said))
        if kernel_cache.folder():
            kernel_cache.write(_stamp(work), b"")
    return time.perf_counter() - began


def _stamp(work: str) -> str:
    from engine.kernels.kernel_cache import path_of
    from engine.kernels.native_check import calls_native

    return path_of(work, "stamp", sys.version, f"native {calls_native()}", *_sources())


def _sources() -> list[str]:
    """Name, date and size of every module; by `os.walk`, which takes a third of `Path.rglob`'s time."""
    start, facts = len(str(_ENGINE)), []
    for place, _, names in os.walk(_ENGINE):
        for name in names:
            if name.endswith(".py"):
                found = os.stat(f"{place}/{name}")
                facts.append(f"{place[start:]}/{name} {found.st_mtime_ns} {found.st_size}")
    return sorted(facts)


if __name__ == "__main__":
    _console = Console(False)
    with _console.progress() as _progress:
        prepare_kernels(_console, _progress, "everything")
