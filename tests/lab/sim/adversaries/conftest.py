"""A real scene, marked, in three copies."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from engine.flows.embed.embedding import embed_copies
from engine.flows.embed.profiles import profile
from engine.flows.records.opened_record import OpenedRecord, open_record
from engine.formats import read_model
from engine.lab.evaluate.marked_scene import bench_key
from engine.model import GaussianModel


@dataclass(frozen=True, eq=False)
class Marked:
    name: str
    original: GaussianModel
    marked: GaussianModel
    opened: OpenedRecord
    copies: tuple[GaussianModel, ...]


@pytest.fixture(scope="session")
def plant() -> GaussianModel:
    """Every sixth Gaussian of a captured plant."""
    whole = read_model(Path(__file__).parents[3] / "data" / "plant.splat").model
    return whole.take(np.arange(0, len(whole), 6))


@pytest.fixture(scope="session")
def scene(plant: GaussianModel) -> Marked:
    key = bench_key(3)
    config = profile("fast", landmark_views=0, views=3, view_size=200)
    names = [f"buyer {i}" for i in range(3)]
    made = list(embed_copies(plant, key, names, original_sha256="33" * 32, bits=16, config=config))
    opened = open_record(made[0].record.to_bytes(key), key)
    return Marked("plant", plant, made[0].model, opened, tuple(m.model for m in made[1:]))
