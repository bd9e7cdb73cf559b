from __future__ import annotations

import fcntl
import os
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar, cast

import numpy as np
import pytest

from engine.flows.embed.copy_mark import mark_again
from engine.flows.embed.embedding import embed_copies
from engine.flows.embed.profiles import profile
from engine.flows.records.opened_record import OpenedRecord, open_record
from engine.lab.evaluate.marked_scene import MarkedScene, bench_key, mark_scene
from engine.model import GaussianModel
from tests.scenes import sparse_plant

SCENE = Path(__file__).parents[1] / "data" / "plant.splat"

Made = TypeVar("Made")


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[], Made]) -> Made:
    """What the first worker that needs it makes for all of them."""
    base = factory.getbasetemp()
    folder = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    path = folder / f"{name}.pickle"
    with (folder / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.exists():
            path.write_bytes(pickle.dumps(make()))
    return cast("Made", pickle.loads(path.read_bytes()))


@pytest.fixture(scope="session")
def small_plant(plant: GaussianModel) -> GaussianModel:
    """Every sixth Gaussian: enough of a scene to be fast."""
    return plant.take(np.arange(0, len(plant), 6))


@dataclass(frozen=True)
class FiveCopies:
    """Of one asset, under one key."""

    models: list[GaussianModel]
    opened: list[OpenedRecord]


@pytest.fixture(scope="session")
def five_copies(small_plant: GaussianModel, tmp_path_factory: pytest.TempPathFactory) -> FiveCopies:
    """For "buyer 0" to "buyer 4"; no landmark bank."""
    return made_once(tmp_path_factory, "five_copies", lambda: _five_copies(small_plant))


def _five_copies(small_plant: GaussianModel) -> FiveCopies:
    key, names = bench_key(5), [f"buyer {number}" for number in range(5)]
    config = profile("fast", landmark_views=0, views=3, view_size=160)
    made = list(embed_copies(small_plant, key, names, original_sha256="11" * 32, bits=16, config=config))
    return FiveCopies([each.model for each in made], [open_record(each.record.to_bytes(key), key) for each in made])


@pytest.fixture(scope="session")
def earlier_copies() -> FiveCopies:
    """Three copies of format 2, each with cells, chips and a message of its own."""
    folder, key = SCENE.parent / "records" / "copies_v2", bench_key(5)
    opened = [open_record((folder / f"buyer_{number}.m3dr").read_bytes(), key) for number in range(3)]
    return FiveCopies([mark_again(each) for each in opened], opened)


@pytest.fixture(scope="session")
def third(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A third of the plant's Gaussians: evidence enough for every route, in two thirds of the time."""
    path = tmp_path_factory.mktemp("third") / "plant.splat"
    path.write_bytes(sparse_plant(every=3))
    return path


@pytest.fixture(scope="session")
def scene(third: Path, tmp_path_factory: pytest.TempPathFactory) -> MarkedScene:
    """A third of the real plant, marked with 32 bits at 47 dB; no landmark bank."""
    config = profile("fast", landmark_views=0, view_size=512)
    return made_once(tmp_path_factory, "scene", lambda: mark_scene(third, config))


@pytest.fixture(scope="session")
def whole_scene(tmp_path_factory: pytest.TempPathFactory) -> MarkedScene:
    """All of it: for bounds on what little a damaged picture still says, or on fidelity."""
    config = profile("fast", landmark_views=0, view_size=512)
    return made_once(tmp_path_factory, "whole_scene", lambda: mark_scene(SCENE, config))


@pytest.fixture(scope="session")
def other(third: Path) -> MarkedScene:
    """The same, marked by somebody else."""
    return mark_scene(third, profile("fast", landmark_views=0, views=3, view_size=256), seed=1)
