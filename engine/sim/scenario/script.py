"""A scenario as it is written: objects, steps, how it is shown. Nothing is loaded or run here."""

from dataclasses import dataclass
from pathlib import Path

from engine.errors import InputError
from engine.sim.scenario.steps import NamedStep, read_step
from engine.sim.scenario.tables import Table, read_table

__all__ = ["Film", "Part", "Photos", "Scenario", "read_scenario"]

MAX_STEPS = 200
MAX_OBJECTS = 64


@dataclass(frozen=True)
class Photos:
    """Photos with a COLMAP reconstruction, from which an object is trained.

    Parameters
    ----------
    colmap, images : Path
        Folders of the reconstruction and of the photos.
    size : int
        Longest side of the photos in training, pixels.
    hold_out : int
        One photo of so many is kept for measuring.
    """

    colmap: Path
    images: Path
    size: int
    steps: int
    hold_out: int


@dataclass(frozen=True)
class Part:
    """One object at the start.

    Parameters
    ----------
    source : Path or Photos
        A model file, or what to train one from.
    bits : int
        Length of its message; 0 leaves it unmarked.
    profile : str
        Of the embedding.
    shift, turn : (3,)
        Placement: scene units, and a rotation vector in degrees.
    """

    name: str
    source: Path | Photos
    bits: int
    profile: str
    shift: tuple[float, ...]
    turn: tuple[float, ...]
    scale: float


@dataclass(frozen=True)
class Film:
    """How the run is shown: pixels, frames a step (0: no film), frames a second."""

    size: tuple[int, int]
    frames: int
    rate: float


@dataclass(frozen=True)
class Scenario:
    """What happens, in order.

    Parameters
    ----------
    seed : int
        Of the key and of every random choice.
    parts : tuple of Part
    steps : tuple of NamedStep
    """

    title: str
    seed: int
    parts: tuple[Part, ...]
    steps: tuple[NamedStep, ...]
    film: Film


def read_scenario(path: str | Path) -> Scenario:
    """Read a TOML file; model paths in it are relative to its folder.

    Raises
    ------
    InputError
        Naming file, table and value of the first thing that does not fit.
    """
    path = Path(path)
    top = read_table(path)
    parts = [_part(table) for table in top.tables("objects")]
    if not 1 <= len(parts) <= MAX_OBJECTS:
        raise InputError(f"{path}: a scenario has 1 to {MAX_OBJECTS} [[objects]], got {len(parts)}")
    names = [part.name for part in parts]
    if len(set(names)) != len(names):
        raise InputError(f"{path}: two objects have the same name; got {', '.join(names)}")
    tables = top.tables("steps")
    if len(tables) > MAX_STEPS:
        raise InputError(f"{path}: a scenario has at most {MAX_STEPS} [[steps]], got {len(tables)}")
    scenario = Scenario(
        title=top.text("title", path.stem),
        seed=top.integer("seed", 0, 0, 2**63 - 1),
        parts=tuple(parts),
        steps=tuple(read_step(table) for table in tables),
        film=_film(top.table("film") or Table({}, f"{path}: film", path.parent)),
    )
    top.done()
    return scenario


def _part(table: Table) -> Part:
    if "photos" in table:
        source: Path | Photos = Photos(
            table.file("colmap"),
            table.file("photos"),
            table.integer("size", 400, 64, 4096),
            table.integer("steps", 2000, 1, 1_000_000),
            table.integer("hold_out", 8, 0, 1000),
        )
        name = "capture"
    else:
        source = table.file("model")
        name = source.name.split(".")[0]
    part = Part(
        name=table.text("name", name),
        source=source,
        bits=table.integer("bits", 32, 0, 256),
        profile=table.text("profile", "balanced"),
        shift=table.vector("shift", (0.0, 0.0, 0.0)),
        turn=table.vector("turn", (0.0, 0.0, 0.0)),
        scale=table.number("scale", 1.0, 1e-6, 1e6),
    )
    table.done()
    return part


def _film(table: Table) -> Film:
    width, height = (int(side) for side in table.vector("size", (640, 480), 2))
    if not (64 <= width <= 3840 and 64 <= height <= 2160):
        raise InputError(f"{table.place}: size must lie in 64..3840 by 64..2160, got {width}x{height}")
    film = Film((width, height), table.integer("frames", 16, 0, 1000), table.number("rate", 12.0, 1.0, 60.0))
    table.done()
    return film
