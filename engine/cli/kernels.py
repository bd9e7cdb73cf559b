"""Compiled kernels: the first run on a machine compiles them, and says so."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING

from engine.cli.console import Console, Progress

if TYPE_CHECKING:
    from engine.pipeline.warming import Work

LOADING_SECONDS = 4.0
"""Loading compiled kernels from the cache takes less; whoever waits longer is being compiled for."""


def prepare_kernels(console: Console, progress: Progress, work: Work = "embed") -> float:
    """Load the compiled kernels of some work, in so many seconds; where they are not there yet, say what is awaited."""
    from engine.pipeline.warming import expected_seconds, warm_up

    began = time.perf_counter()
    notice = threading.Timer(
        LOADING_SECONDS, console.note, [f"compiling kernels, once per machine: about {expected_seconds(work):.0f} s"]
    )
    notice.daemon = True
    notice.start()
    try:
        warm_up(work, lambda fraction: progress("compile", fraction))
    finally:
        notice.cancel()
    return time.perf_counter() - began
