"""Compiled kernels: the first run on a machine compiles them, and says so."""

from __future__ import annotations

from engine.cli.console import Console, Progress


def prepare_kernels(console: Console, progress: Progress) -> None:
    """Compile (once per machine) or load what the engine needs, telling the user when that takes long."""
    from engine.raster import warm_up

    warm_up(lambda fraction: progress("compile", fraction))
