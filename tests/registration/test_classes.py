"""Centres moved by a part, or by multiples, of each Gaussian's own size."""

from __future__ import annotations

import numpy as np
import pytest

from engine.model import GaussianModel
from engine.numerics.umeyama import Similarity
from engine.registration.looks_index import ReferenceIndex
from engine.registration.match_classes import by_size
from engine.registration.matching import estimate_deviations
from engine.registration.registration_search import RegistrationConfig, register
from tests.registration.registration_cases import marked, merged, moved, noised, scene, shuffled

RIGID = RegistrationConfig(deformed=False)


def wide() -> GaussianModel:
    """A scene whose largest Gaussians are a hundred times the smallest."""
    model = scene(0)
    spread = np.random.default_rng(5).uniform(-2.5, 2.5, (len(model), 1))
    return model.with_(log_scales=model.log_scales + spread)


def shaken(model: GaussianModel, sizes: float) -> GaussianModel:
    """Centres noised by so many of their own standard deviations, along their own axes about; sizes by 0.05."""
    rng = np.random.default_rng(0)
    return model.with_(
        means=model.means + sizes * np.exp(model.log_scales) * rng.normal(size=model.means.shape),
        log_scales=model.log_scales + rng.normal(0, 0.05, model.log_scales.shape),
    )


@pytest.mark.parametrize("sizes", [0.1, 0.3, 1.0, 4.0])
def test_centres_off_by_parts_of_their_own_size(sizes: float) -> None:
    model = wide()
    order = shuffled(model, 0.8)
    got = register(model, moved(shaken(marked(model), sizes).take(order)), config=RIGID)
    assert (got.matches == order).mean() > 0.95
    assert ((got.matches >= 0) & (got.matches != order)).mean() < 0.005
    assert got.derived_fraction == pytest.approx(0.8, abs=0.04)


def test_in_order_too_and_beside_strangers() -> None:
    model = wide()
    got = register(model, shaken(marked(model), 0.3), config=RIGID)
    assert (got.matches == np.arange(len(model))).mean() > 0.98
    order = shuffled(model)
    suspect = merged(shaken(marked(model), 1.0).take(order), scene(1))
    got = register(model, moved(suspect), config=RIGID)
    assert (got.matches[: len(order)] == order).mean() > 0.95
    assert (got.matches[len(order) :] >= 0).mean() < 0.005


def classes_of(suspect: GaussianModel, in_order: bool) -> object:
    index, rng = ReferenceIndex(wide()), np.random.default_rng(0)
    rows, same = np.arange(len(suspect)), Similarity.identity()
    errors = estimate_deviations(index.model, suspect, (rows, rows), same, index.floor)
    return by_size(index.model, suspect, same, errors, index.floor, rng, in_order=in_order)


@pytest.mark.parametrize("in_order", [False, True])
def test_there_are_classes_only_where_errors_grow_with_size(in_order: bool) -> None:
    model = wide()
    assert classes_of(shaken(marked(model), 0.3), in_order) is not None
    assert classes_of(marked(model), in_order) is None
    assert classes_of(noised(marked(model), 0.1), in_order) is None


def test_known_partners_that_lie_elsewhere_teach_no_errors() -> None:
    """A quarter of the scene was carried away: the errors are those of the rest."""
    suspect = shaken(marked(wide()), 0.3)
    away = suspect.means.copy()
    away[::4] += 50.0
    kept, rest = (classes_of(each, in_order=True) for each in (suspect, suspect.with_(means=away)))
    for one, other in zip(kept.matchers, rest.matchers, strict=True):  # type: ignore[attr-defined]
        np.testing.assert_allclose(other.deviations.position, one.deviations.position, rtol=0.3)


@pytest.mark.parametrize("in_order", [False, True])
def test_a_class_pairs_rows_of_the_whole_reference(in_order: bool) -> None:
    model = wide()
    suspect = shaken(marked(model), 0.3)
    sized = classes_of(suspect, in_order)
    assert sized is not None
    errors = sized.matchers[0].deviations  # type: ignore[attr-defined]
    matches, quality = sized.pair(suspect, Similarity.identity(), errors)  # type: ignore[attr-defined]
    assert (matches == np.arange(len(model))).mean() > 0.95
    assert ((quality > 0) == (matches >= 0)).all()
    sigmas = [m.deviations.position.mean() for m in sized.matchers]  # type: ignore[attr-defined]
    assert sigmas == sorted(sigmas)
    assert sigmas[-1] > 5 * sigmas[0]


def test_strangers_larger_than_all_of_the_reference_do_no_harm() -> None:
    model = wide()
    order = shuffled(model)
    giants = scene(1).with_(log_scales=scene(1).log_scales + np.float32(12))
    got = register(model, moved(merged(shaken(marked(model), 0.3).take(order), giants)), config=RIGID)
    assert (got.matches[: len(order)] == order).mean() > 0.9
    assert (got.matches[len(order) :] >= 0).mean() < 0.005
