"""Levels of detail and half precision: smaller, still alike, and still marked."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from engine.compress.levels_of_detail import merge_pairs
from engine.errors import InputError
from engine.flows.embed.profiles import profile
from engine.flows.verify.search import verify_model
from engine.lab.evaluate.marked_scene import MarkedScene, mark_scene
from engine.lab.sim.scenario.capture_steps import half_precision
from engine.model import GaussianModel
from engine.watermark.claim import Verdict

PLANT = Path(__file__).parents[3] / "data" / "plant.splat"


@cache
def plant() -> MarkedScene:
    """The real scene, marked; extraction is informed: it uses the owner's record."""
    return mark_scene(PLANT, profile("fast", landmark_views=0))


@pytest.mark.parametrize("share", [0.5, 0.1])
def test_the_mark_survives_levels_of_detail(share: float) -> None:
    level = merge_pairs(plant().marked, share, surface=True)
    assert len(level) == round(share * len(plant().marked))
    claim = verify_model(level, plant().opened).claim
    assert claim.verdict is Verdict.MARKED
    assert claim.bit_accuracy == 1.0


def test_half_precision_rounds_and_the_mark_survives() -> None:
    marked = plant().marked
    half = half_precision(marked)
    assert not np.array_equal(half.means, marked.means)
    for name in ("means", "log_scales", "opacity_logits", "sh"):
        array = getattr(half, name)
        np.testing.assert_array_equal(array, array.astype(np.float16).astype(np.float32))
        np.testing.assert_allclose(array, getattr(marked, name), rtol=2.0**-11, atol=2.0**-24)
    np.testing.assert_allclose(np.linalg.norm(half.quats, axis=1), 1.0, atol=1e-6)
    claim = verify_model(half, plant().opened).claim
    assert claim.verdict is Verdict.MARKED
    assert claim.bit_accuracy == 1.0


def test_refused(model: GaussianModel) -> None:
    with pytest.raises(InputError, match=r"means: row 0 is too large for float16"):
        half_precision(model.with_(means=model.means * 1e5))
