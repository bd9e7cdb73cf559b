"""A piece of the shipped scene, small enough for the quick run of a study to be quick."""

from __future__ import annotations

from pathlib import Path

from engine.formats import read_model, write_model
from engine.lab.sim.attacks import model_attack

PLANT = Path(__file__).parents[2] / "data" / "plant.splat"


def write_piece(folder: Path, share: float = 0.2) -> Path:
    """A connected piece of the plant as a PLY."""
    path = folder / "piece.ply"
    write_model(model_attack("crop").apply(read_model(PLANT).model, share, rng=0), path)
    return path
