"""What a format cannot hold of a model is said."""

from __future__ import annotations

import numpy as np
import pytest

from engine.formats.file_writing import loss_note
from engine.model import GaussianModel
from engine.numerics.gaussians import flatten


def model(coefficients: int) -> GaussianModel:
    rng = np.random.default_rng(0)
    quats = np.tile(np.array([1.0, 0.0, 0.0, 0.0]), (20, 1))
    return GaussianModel(
        rng.normal(size=(20, 3)), rng.normal(size=(20, 3)), quats, np.zeros(20), np.zeros((20, coefficients, 3))
    )


def test_splat_drops_spherical_harmonics() -> None:
    assert ["degree 1" in note for note in loss_note(model(4), "splat")] == [True]
    assert loss_note(model(1), "splat") == loss_note(model(4), "spz") == []


@pytest.mark.parametrize("kind", ["splat", "spz"])
def test_only_ply_has_the_two_scales_of_discs(kind: str) -> None:
    discs = flatten(model(1))
    assert loss_note(discs, "ply") == []
    note = next(note for note in loss_note(discs, kind) if "2DGS" in note)
    assert ("as thin as it allows" in note) == (kind == "spz")
