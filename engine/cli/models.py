"""Models on the command line: formats by file ending, what a format cannot hold, repairs in words."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from engine.cli.console import Console, Progress
from engine.errors import InputError

if TYPE_CHECKING:
    from engine.flows.verify.search import Suspect
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


def load_suspect(
    console: Console, paths: list[Path], cameras: Path | None, progress: Progress, spz_frame: str = "auto"
) -> tuple[Suspect, tuple[Repair, ...]]:
    """`read_suspect`, told as it goes."""
    progress("read", 0.0)
    suspect, repairs = read_suspect(paths, cameras, spz_frame)
    say_repairs(console, repairs)
    return suspect, repairs


def read_suspect(
    paths: list[Path], cameras: Path | None, spz_frame: str = "auto"
) -> tuple[Suspect, tuple[Repair, ...]]:
    """What a verification or a tracing looks at, and what was mended on loading; `are_pictures` has let it pass."""
    from engine.formats.image_files import is_picture

    if is_picture(paths[0]):
        from engine.formats import read_cameras
        from engine.formats.image_files import read_picture

        known = read_cameras(cameras) if cameras is not None else None
        pictures = [read_picture(path) for path in paths]
        from engine.flows.verify.search import Suspect

        return Suspect(None, pictures, known), ()
    from engine.scenes.scene_files import read_scene

    loaded = read_scene(paths[0], spz_frame=spz_frame)
    from engine.flows.verify.search import Suspect  # after the file: to import it takes as long as to read it

    return Suspect(loaded.model), loaded.repairs


def shipped_scene() -> Path:
    """The real scene that ships with the repository."""
    scene = Path(__file__).resolve().parents[2] / "tests" / "data" / DEMO_SCENE
    if not scene.is_file():
        raise InputError(
            f"the scene tests/data/{DEMO_SCENE} is not beside this installation (it ships with the"
            " repository): name a model of your own"
        )
    return scene
