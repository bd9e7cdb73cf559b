"""How much the tables measure: everything, or a few small cells of each kind."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from engine.evaluate.study import Options

__all__ = ["Effort", "scenes_of"]


@dataclass(frozen=True)
class Effort:
    """Repeats and sizes of one run.

    Parameters
    ----------
    keys : int
        Owner keys, and with them pose keys, chips and messages, that every scene is marked under.
    views : int
        Pictures of a marked model, from views that are not the key views.
    size : int
        Their side, pixels; 176 at least.
    sweep_keys, sweep_views, sweep_size : int
        The same where one knob is turned after the other.
    changes : dict
        Settings of every embedding of this run that differ from the profile's.
    """

    keys: int = 3
    views: int = 4
    size: int = 800
    sweep_keys: int = 2
    sweep_views: int = 3
    sweep_size: int = 480
    changes: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, options: Options) -> Effort:
        """All of it, or the quick version."""
        if not options.quick:
            return cls()
        return cls(1, 1, 256, 1, 1, 192, {"views": 2, "view_size": 256})


def scenes_of(options: Options) -> Iterator[tuple[str, str]]:
    """A short name for cells, and the path, of each scene."""
    for number, path in enumerate(options.scenes):
        safe = "".join(c if c.isalnum() else "_" for c in Path(path).name.split(".")[0])
        yield f"{safe}{number}", path
