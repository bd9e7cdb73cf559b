"""What several commands of the laboratory share."""

from pathlib import Path
from typing import Annotated

import typer

from engine.errors import InputError

Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of every random choice.")]

DEMO_SCENE = "plant.splat"


def shipped_scene() -> Path:
    """The real scene that ships with the repository."""
    scene = Path(__file__).resolve().parents[3] / "tests" / "data" / DEMO_SCENE
    if not scene.is_file():
        raise InputError(
            f"the scene tests/data/{DEMO_SCENE} is not part of this installation (it ships with the"
            " repository): name a model of your own"
        )
    return scene
