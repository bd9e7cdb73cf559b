"""The plant, and landmarks of it."""

from __future__ import annotations

import pytest

from engine.model import GaussianModel
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.pictures.landmarks.rendered_landmarks import make_landmarks
from tests.pictures.plant_views import around


@pytest.fixture(scope="module")
def bank(plant: GaussianModel) -> Landmarks:
    views = [around(plant, 30.0 * k, 20.0 + 20.0 * (k % 2), 1.3, 1.1) for k in range(12)]
    return make_landmarks(plant, views)
