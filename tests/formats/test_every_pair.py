"""A real scene through every pair of formats: what the last file lost is what its notes say, Gaussian by Gaussian."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from engine.formats import encode_model, read_model
from engine.model import GaussianModel
from tests.formats.round_trips import KINDS, OPACITY, TURN, round_trip

SCENE = Path(__file__).parents[1] / "data" / "train_1000.ply"


@cache
def through(kind: str) -> GaussianModel:
    """The scene, with a few values that few formats hold, as it comes out of a file of this kind."""
    model = read_model(SCENE).model
    log_scales, sh = model.log_scales.copy(), model.sh.copy()
    log_scales[7] = -14.0
    sh[11:14, 0] = [4.0, -4.0, 1.5]
    sh[400:405, 5] = 4.5
    return read_model(encode_model(model.with_(log_scales=log_scales, sh=sh), kind)).model


@pytest.mark.parametrize("to", KINDS)
@pytest.mark.parametrize("come", KINDS)
def test_what_is_lost_is_told(come: str, to: str) -> None:
    trip = round_trip(through(come), to)
    assert trip.faults == ()
    assert trip.notes == trip.losses
    assert trip.opacity <= OPACITY.get(to, 0) + 1e-6
    assert trip.turn <= TURN.get(to, 0) + 1e-4
