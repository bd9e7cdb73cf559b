from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from engine.evaluate.marked_scene import MarkedScene, mark_scene
from engine.formats import read_model
from engine.model import GaussianModel
from engine.pipeline.profiles import profile

SCENE = Path(__file__).parents[1] / "data" / "plant.splat"


@pytest.fixture(scope="session")
def plant() -> GaussianModel:
    return read_model(SCENE).model


@pytest.fixture(scope="session")
def small_plant(plant: GaussianModel) -> GaussianModel:
    """Every sixth Gaussian: enough of a scene to be fast."""
    return plant.take(np.arange(0, len(plant), 6))


@pytest.fixture(scope="session")
def scene() -> MarkedScene:
    """The real plant, marked with 32 bits at 47 dB; no landmark bank."""
    return mark_scene(SCENE, profile("fast", landmark_views=0, view_size=512))


@pytest.fixture(scope="session")
def other() -> MarkedScene:
    """The same plant, marked by somebody else."""
    return mark_scene(SCENE, profile("fast", landmark_views=0, views=3, view_size=256), seed=1)
