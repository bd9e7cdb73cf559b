"""What no viewer draws stands for nothing, but for what the original itself hides."""

from __future__ import annotations

import numpy as np
import pytest

from engine.model import ATTRIBUTES, GaussianModel
from engine.registration.registration_search import register
from engine.registration.sketch import SuspectIndex
from engine.registration.visibility import drawn, only_drawn
from tests.registration.registration_cases import marked, moved, scene, shuffled

FAINT = np.float32(np.log(0.003 / 0.997))
BYTE = np.float32(-np.log(254.0))
"""One step of 8-bit opacity."""


def visible() -> GaussianModel:
    model = scene(0)
    return model.with_(opacity_logits=np.maximum(model.opacity_logits, np.float32(-4.0)))


def twins(model: GaussianModel, logit: np.float32, seed: int = 0) -> GaussianModel:
    rng = np.random.default_rng(seed)
    sizes = np.exp(model.log_scales.mean(axis=1, keepdims=True))
    means = model.means + 0.05 * sizes * rng.normal(size=model.means.shape)
    return model.with_(means=means, opacity_logits=np.full(len(model), logit))


def joined(*models: GaussianModel) -> GaussianModel:
    return GaussianModel(**{name: np.concatenate([getattr(each, name) for each in models]) for name in ATTRIBUTES})


def test_faint_and_sizeless_gaussians_are_not_drawn() -> None:
    model = visible().take(np.arange(4))
    logits = np.array([FAINT, BYTE, 0.0, 0.0], np.float32)
    scales = model.log_scales.copy()
    scales[3] = -30.0
    scales[2, 2] = -30.0
    mixed = model.with_(opacity_logits=logits, log_scales=scales)
    assert drawn(mixed).tolist() == [False, True, True, False]
    assert len(only_drawn(mixed)) == 2
    assert len(only_drawn(mixed.take([0, 3]))) == 2, "nothing would be left"


@pytest.mark.parametrize("move", [None, "small"])
def test_chaff_changes_nothing_and_rows_stay_the_suspects_own(move: str | None) -> None:
    reference = visible()
    copy = marked(reference).take(shuffled(reference))
    suspect = joined(copy, *(twins(copy, FAINT, seed) for seed in range(3)))
    order = np.random.default_rng(5).permutation(len(suspect))
    # The real ones keep their order among each other, so that both registrations draw the same samples.
    real = np.sort(np.argsort(order)[: len(copy)])
    suspect = suspect.take(order)
    if move is not None:
        suspect = moved(suspect, move)
    got, plain = register(reference, suspect), register(reference, suspect.take(real))
    assert got.undrawn == 3 * len(copy)
    assert plain.undrawn == 0
    assert np.array_equal(got.matches[real], plain.matches)
    assert np.array_equal(got.match_quality[real], plain.match_quality)
    others = np.setdiff1d(np.arange(len(suspect)), real)
    assert (got.matches[others] == -1).all()
    assert got.derived_fraction == plain.derived_fraction > 0.999


@pytest.mark.parametrize("keep", ["order", "shuffle", "crop"])
def test_what_the_original_hides_is_still_matched(keep: str) -> None:
    reference = visible()
    logits = reference.opacity_logits.copy()
    logits[::10] = FAINT
    reference = reference.with_(opacity_logits=logits)
    rows = {
        "order": np.arange(len(reference)),
        "shuffle": shuffled(reference),
        "crop": np.flatnonzero(reference.means[:, 0] > np.median(reference.means[:, 0])),
    }[keep]
    got = register(reference, marked(reference).take(rows))
    assert got.undrawn <= 0.001 * len(rows)
    assert (got.matches == rows).mean() > 0.999


def test_chaff_in_the_places_of_real_ones_is_nothing_even_in_order() -> None:
    reference = visible()
    copy = marked(reference)
    logits = copy.opacity_logits.copy()
    logits[: len(copy) // 3] = FAINT
    got = register(reference, copy.with_(opacity_logits=logits))
    assert got.undrawn == len(copy) // 3
    assert (got.matches[: len(copy) // 3] == -1).all()
    assert got.derived_fraction == pytest.approx(2 / 3, abs=0.01)


def test_a_suspects_looks_are_of_what_is_drawn() -> None:
    model = visible()
    suspect = joined(twins(model, FAINT), model)
    assert np.array_equal(SuspectIndex(suspect).telling_looks, SuspectIndex(model).telling_looks)
