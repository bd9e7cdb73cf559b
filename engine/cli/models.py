"""Models on the command line: formats by file ending, what a format cannot hold, repairs in words."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from engine.cli.console import Console
from engine.errors import InputError

if TYPE_CHECKING:
    from engine.formats import Repair

DEMO_SCENE = "plant.splat"


def format_for(path: Path, source: Path | None = None) -> str:
    """Format that the ending of an output file names; where the source is a folder of frames or codebooks, that."""
    if source is not None and source.is_dir():
        from engine.scenes.scene_files import folder_kind

        if (kind := folder_kind(source)) is not None:
            return kind
    from engine.formats.kinds import kind_of

    return kind_of(path.name).name


def say_repairs(console: Console, repairs: Iterable[Repair]) -> None:
    """Tell what was mended on loading."""
    for repair in repairs:
        console.note(f"repaired: {repair.text}")


def shipped_scene() -> Path:
    """The real scene that ships with the repository."""
    scene = Path(__file__).resolve().parents[2] / "tests" / "data" / DEMO_SCENE
    if not scene.is_file():
        raise InputError(
            f"the scene tests/data/{DEMO_SCENE} is not beside this installation (it ships with the"
            " repository): name a model of your own"
        )
    return scene
