"""What a model looks like from a little way off."""

from __future__ import annotations

import numpy as np
import pytest

from engine.model import ATTRIBUTES, GaussianModel
from engine.numerics.similarity import mirror_model, transform_model
from engine.registration import coarse
from engine.registration.coarse import FEATURES, Coarse, Crowd, agreement, describe
from tests.reference.coarse import moments
from tests.registration.outside_tools import merged_to
from tests.registration.registration_cases import MOVES, moved, near, scene
from tests.threads import with_one_and_two_threads


def empty(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros((len(places), 2, 22)), np.zeros(len(places), np.int64)


def features(mass: np.ndarray, at: np.ndarray, color: np.ndarray, places: np.ndarray, width: float) -> np.ndarray:
    moments, count = empty(places)
    coarse._moments(mass, at, color, places, width, 2.5 * width, moments, count)
    return coarse._features(moments[:, 1], width)


@pytest.mark.parametrize("compiled", [True, False])
def test_moments_are_those_of_the_twin(compiled: bool) -> None:
    rng = np.random.default_rng(0)
    mass, where, color = rng.random(40), rng.normal(size=(40, 3)), rng.random((40, 3))
    places = rng.normal(size=(5, 3))
    kernel = coarse._moments if compiled else coarse._moments.py_func
    got, count = empty(places)
    kernel(mass, where, color, places, 0.6, 1.5, got, count)
    for p, place in enumerate(places):
        wanted, near_by = moments(mass, where, color, place, 0.6, 1.5)
        np.testing.assert_allclose(got[p], wanted, rtol=1e-10, atol=1e-13)
        assert count[p] == near_by
    assert 0 < count.max() < 40


def test_features_are_left_alone_by_similarity_and_mirror() -> None:
    """At the very same places, which voxels along the axes otherwise move a little."""
    model = scene(0, 4000)
    rows = np.concatenate([model.means.astype(float), np.random.default_rng(1).random((len(model), 3))], axis=1)
    mass = np.random.default_rng(2).random(len(model))
    scale, R, t = MOVES["small"]
    for turn in (R, R @ np.diag([-1.0, 1, 1])):
        there = rows[:, :3] @ (scale * turn).T + t
        own, other = (
            features(mass, at, rows[:, 3:], at[:50], w) for at, w in ((rows[:, :3], 0.8), (there, 0.8 * scale))
        )
        np.testing.assert_allclose(other, own, atol=1e-9)
    assert own.shape == (50, FEATURES // 2)
    assert (own.std(axis=0) > 0.01).all()


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("share", [1.0, 0.1])
def test_a_derivative_agrees_and_a_stranger_does_not(share: float, mirrored: bool) -> None:
    model = scene(0)
    suspect = moved(merged_to(model, share).take(near(merged_to(model, share), 1.0)), "large")
    crowd = Crowd(describe(mirror_model(suspect) if mirrored else suspect, 2000, 5))
    assert agreement(describe(model, 256), crowd) > 200
    for seed in (1, 2, 3):
        assert agreement(describe(scene(seed), 256), crowd) < 60


def test_only_a_ladder_of_sizes_knows_a_piece() -> None:
    """A piece is smaller than the whole, and so are its neighbourhoods: they must grow to be the whole's."""
    model = scene(0)
    cut = model.take(near(model, 0.35))
    found = [agreement(describe(model, 256), Crowd(describe(cut, 2000, steps))) for steps in (1, 5)]
    assert found[1] > found[0] + 30
    sizes = describe(cut, 100, 3).sizes
    np.testing.assert_allclose(np.unique(sizes)[1:] / np.unique(sizes)[:-1], 1.25, rtol=1e-5)


def test_the_same_places_elsewhere_do_not_agree() -> None:
    own = describe(scene(0), 256)
    order = np.random.default_rng(0).permutation(len(own))
    thrown = Coarse(own.places[order], own.features, own.sizes)
    assert agreement(own, Crowd(own)) > 200
    assert agreement(own, Crowd(thrown)) < 60


def test_a_floater_moves_nothing() -> None:
    model = scene(0, 4000)
    far = model.take(np.arange(3)).with_(means=np.float32([[1e7, 0, 0], [0, -1e7, 3], [0, 0, 1e6]]))
    names = ATTRIBUTES
    with_floaters = GaussianModel(*(np.concatenate([getattr(model, n), getattr(far, n)]) for n in names))
    assert agreement(describe(model, 256), Crowd(describe(with_floaters, 2000, 5))) > 200


@pytest.mark.parametrize("count", [1, 3, 30])
def test_what_is_too_small_says_nothing(count: int) -> None:
    model = scene(0)
    few = describe(model.take(np.arange(count)), 256, 2)
    assert few.features.shape[1] == FEATURES
    assert agreement(few, Crowd(describe(model, 100))) < 60
    assert agreement(describe(model, 256), Crowd(few)) < 60
    point = model.with_(means=np.zeros_like(model.means))
    assert len(describe(point, 256)) == 0


def test_the_same_answer_on_any_number_of_threads() -> None:
    model = transform_model(scene(0), *MOVES["z-up"])
    one, two = with_one_and_two_threads(lambda: describe(model, 256))
    assert one.features.tobytes() == two.features.tobytes()
    a, b = with_one_and_two_threads(lambda: agreement(describe(scene(0), 256), Crowd(one)))
    assert a == b
