"""Words for timings that were taken on a busy machine."""

from collections.abc import Sequence

from engine.evaluate.study import Row

__all__ = ["busy_words"]

BUSY = 1.5
"""Programs a core (`engine.numerics.machine.load_per_core`) from which on times are called too long."""


def busy_words(rows: Sequence[Row]) -> list[str]:
    """A paragraph where rows with a `busy` were measured beside other work; none otherwise."""
    most = max((row.get("busy") or 0.0 for row in rows), default=0.0)
    if most <= BUSY:
        return []
    return [
        f"The machine was busy with other work (up to {most:.1f} programs a core): all seconds here are too long, and "
        "differences between settings in time are not to be trusted; processor time still is."
    ]
