"""Compiled kernels: the first run on a machine compiles them, and says so. `python -m
engine.cli.kernel_progress` does nothing else, for all of them."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from engine.cli.console import Console, Progress

if TYPE_CHECKING:
    from engine.flows.warmup.kernel_warmup import Work


def prepare_kernels(console: Console, progress: Progress, work: Work = "embed") -> float:
    """Compile the kernels of some work where they are not there yet, in so many seconds, and say what is awaited."""
    from engine.kernels.stamp import is_stamped, stamp

    began = time.perf_counter()
    if is_stamped(work):
        return time.perf_counter() - began
    from engine.flows.warmup.kernel_warmup import expected_seconds, warm_up

    said = f"compiling kernels, once per machine: about {expected_seconds(work):.0f} s on free, quick cores"
    warm_up(work, lambda fraction: progress("compile", fraction), compiling=lambda: console.note(said))
    stamp(work)
    return time.perf_counter() - began


if __name__ == "__main__":
    _console = Console(False)
    with _console.progress() as _progress:
        prepare_kernels(_console, _progress, "everything")
