"""Models on the command line: formats by file ending, what a format cannot hold, repairs in words."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from engine.cli.console import Console

if TYPE_CHECKING:
    from engine.formats import Repair


def format_for(path: Path, source: Path | None = None) -> str:
    """Format that the ending of an output file names; where the source is a folder of frames or codebooks, that."""
    if source is not None and source.is_dir():
        from engine.scenes.scene_files import folder_kind

        if (kind := folder_kind(source)) is not None:
            return kind
    from engine.formats.known_formats import kind_of

    return kind_of(path.name).name


def say_repairs(console: Console, repairs: Iterable[Repair]) -> None:
    """Report what was repaired on loading."""
    for repair in repairs:
        console.note(f"repaired: {repair.text}")
