"""A model placed by what it looks like, its Gaussians unknown."""

from __future__ import annotations

import numpy as np
import pytest

from engine.model import GaussianModel
from engine.numerics.similarity import transform_model
from engine.pictures.landmarks import Landmarks, make_landmarks
from engine.pipeline.looking import place_by_looking
from engine.pipeline.rigs import make_rig
from tests.registration.registration_cases import MOVES
from tests.registration.registration_cases import scene as made_up


@pytest.fixture(scope="module")
def model(plant: GaussianModel) -> GaussianModel:
    part = plant.take(np.arange(0, len(plant), 3))
    return part.with_(log_scales=part.log_scales + np.float32(0.25))  # closes the gaps


@pytest.fixture(scope="module")
def landmarks(model: GaussianModel) -> Landmarks:
    return make_landmarks(model, make_rig(model, 12, 640, 480))


@pytest.mark.parametrize("move", ["small"])
def test_the_place_found_by_looking_is_exact(model: GaussianModel, landmarks: Landmarks, move: str) -> None:
    scale, R, t = MOVES[move]
    place = place_by_looking(transform_model(model, scale, R, t), model, landmarks)
    assert place is not None
    assert len(place.sightings) >= 2
    assert place.similarity.scale * scale == pytest.approx(1.0, abs=0.003)
    assert np.trace(place.similarity.R @ R) == pytest.approx(3.0, abs=1e-4)
    back = place.similarity.apply(scale * model.means @ R.T + t)
    assert np.median(np.linalg.norm(back - model.means, axis=1)) < 2e-3 * np.ptp(model.means)


def test_another_scene_is_not_recognised(model: GaussianModel, landmarks: Landmarks) -> None:
    assert place_by_looking(made_up(1, degree=0), model, landmarks) is None
