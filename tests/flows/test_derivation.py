"""What a registration says of where a suspect comes from."""

from __future__ import annotations

import numpy as np
import pytest

from engine.flows.verify.gaussian_evidence import derivation_of_model
from engine.model import GaussianModel
from engine.registration.registration_search import register

pytestmark = pytest.mark.slow


def test_thinned_and_grown_until_each_looks_like_a_mixture(plant: GaussianModel) -> None:
    """Every Gaussian five times as large covers what its neighbours covered: none is matched by itself."""
    few = plant.take(np.arange(0, len(plant), 5))
    grown = few.with_(log_scales=few.log_scales + np.float32(np.log(5) / 2))
    registration = register(plant, grown)
    assert registration.found
    assert not (registration.matches >= 0).any(), "a plain match: look for a suspect that has none"
    derivation = derivation_of_model(plant, grown, registration)
    assert derivation.derived
    assert derivation.exactness is None
    assert derivation.gaussians is not None
    assert derivation.gaussians > 0.9 * len(grown)
    assert derivation.where is not None
    low, high = (np.array(corner) for corner in derivation.where)
    inside = ((plant.means >= low) & (plant.means <= high)).all(axis=1)
    assert 0.9 < inside.mean() < 1.0
