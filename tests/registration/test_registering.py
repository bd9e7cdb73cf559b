"""Registration: undo what a thief does to a model, and find nothing where there is nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.numerics.similarity import quaternion_product
from engine.registration import registration_search as registering
from engine.registration import similarity_search as locating
from engine.registration.config import CONFIG
from engine.registration.registration_search import ReferenceIndex, Registration, register
from tests.registration.registration_cases import (
    MOVES,
    marked,
    merged,
    moved,
    near,
    noised,
    rounded,
    scene,
    shuffled,
    splatted,
    train,
)
from tests.threads import with_one_and_two_threads


def check(
    got: Registration,
    truth: np.ndarray,
    move: str | None = "small",
    *,
    exact: float = 0.999,
    degrees: float = 0.01,
    scale: float = 1e-3,
    false: float = 0.001,
) -> None:
    """Found, at the right place, with at least `exact` of the Gaussians matched to their own original."""
    assert got.found
    s, R = MOVES[move][:2] if move else (1.0, np.eye(3))
    chord = np.linalg.norm(got.R - R.T) / np.sqrt(8)
    assert np.degrees(2 * np.arcsin(chord)) < degrees
    assert got.scale * s == pytest.approx(1, abs=scale)
    ours = truth >= 0
    assert (got.matches[ours] == truth[ours]).mean() >= exact
    assert (got.matches[~ours] >= 0).sum() <= false * len(truth)
    assert ((got.match_quality > 0) == (got.matches >= 0)).all()
    assert got.match_quality.max() <= 1
    assert got.matches.dtype == np.int32
    assert got.match_quality.dtype == np.float32
    assert got.hypotheses_tried >= 1


@pytest.mark.parametrize("level", [0.0, 0.02, 0.1])
@pytest.mark.parametrize("move", [None, "small", "large"])
def test_same_order(level, move):
    suspect = noised(marked(scene(0)), level)
    got = register(scene(0), moved(suspect, move) if move else suspect)
    assert got.hypotheses_tried == 1
    assert got.derived_fraction == pytest.approx(1, abs=0.001)
    check(got, np.arange(len(scene(0))), move, degrees=0.5, scale=0.01)


def test_same_order_is_not_claimed_for_a_shuffle():
    order = shuffled(scene(0))
    got = register(scene(0), marked(scene(0)).take(order))
    assert got.hypotheses_tried > 1
    check(got, order, None)


def test_two_scenes_along_the_same_curve_are_not_in_the_same_order():
    a, b = scene(0), scene(1)
    a, b = a.take(np.argsort(a.means[:, 0])), b.take(np.argsort(b.means[:, 0]))
    assert not register(a, b).found


@pytest.mark.parametrize("lossy", [splatted, rounded])
@pytest.mark.parametrize("move", [None, "spz", "z-up"])
def test_same_frame(lossy, move):
    order = shuffled(scene(0), 0.7)
    suspect = lossy(marked(scene(0))).take(order)
    got = register(scene(0), moved(suspect, move) if move else suspect)
    check(got, order, move)
    assert got.hypotheses_tried <= 24
    assert got.derived_fraction == pytest.approx(0.7, abs=0.01)


@pytest.mark.parametrize("move", ["small", "large", "tiny"])
def test_similarity_and_shuffle(move):
    order = shuffled(scene(0))
    check(register(scene(0), moved(marked(scene(0)).take(order), move)), order, move)


@pytest.mark.parametrize("lossy", [splatted, rounded])
def test_similarity_and_lossy_format(lossy):
    order = shuffled(scene(0))
    check(register(scene(0), moved(lossy(marked(scene(0)).take(order)))), order)


@pytest.mark.parametrize("share", [0.6, 0.25, 0.1, 0.02])
def test_crop(share):
    order = near(scene(0), share)
    got = register(scene(0), moved(marked(scene(0)).take(order)))
    check(got, order)
    assert got.derived_fraction == pytest.approx(share, abs=0.001)


@pytest.mark.parametrize("share", [0.8, 0.5, 0.1])
def test_prune(share):
    order = shuffled(scene(0), share)
    check(register(scene(0), moved(marked(scene(0)).take(order))), order)


def test_clones_share_their_original():
    order = np.concatenate([shuffled(scene(0)), shuffled(scene(0), 0.5, seed=1)])
    got = register(scene(0), moved(marked(scene(0)).take(order)))
    check(got, order)
    assert got.derived_fraction == pytest.approx(1, abs=0.001)
    assert (got.matches >= 0).mean() == pytest.approx(1, abs=0.001)


def test_recoloured():
    order = shuffled(scene(0))
    rng = np.random.default_rng(2)
    model = marked(scene(0))
    tint = model.with_dc(model.sh[:, 0] * [1.3, 0.9, 0.7] + 0.15)
    tuned = model.with_dc(model.sh[:, 0] + rng.normal(0, 0.5, (len(model), 3)))
    gray = model.with_dc(rng.normal(0, 1, (len(model), 3)))
    for suspect in (tint, tuned, gray):
        check(register(scene(0), moved(suspect.take(order))), order, exact=0.99)


@pytest.mark.parametrize("move", [None, "small"])
def test_noise_on_everything(move):
    order = shuffled(scene(0))
    suspect = noised(marked(scene(0)), 0.1).take(order)
    got = register(scene(0), moved(suspect, move) if move else suspect)
    check(got, order, move, exact=0.95, degrees=0.5, scale=0.01)
    right = got.matches == order
    assert got.match_quality[right].mean() > got.match_quality[~right].mean() + 0.2


def test_crop_and_noise():
    order = near(scene(0), 0.1)
    got = register(scene(0), moved(noised(marked(scene(0)), 0.02).take(order)))
    check(got, order, exact=0.98, degrees=0.5, scale=0.01)


def test_useless_rotations():
    """A tool may write the same ellipsoid with its axes in another order."""
    model = marked(scene(0))
    cycle = np.array([0.5, 0.5, 0.5, 0.5])  # x to y to z to x
    relabelled = model.with_(quats=quaternion_product(model.quats, cycle), log_scales=model.log_scales[:, [2, 0, 1]])
    order = shuffled(model)
    check(register(scene(0), moved(relabelled.take(order), "large")), order, "large")


@pytest.mark.parametrize(("share", "level"), [(0.3, 0.0), (0.05, 0.0), pytest.param(0.4, 0.05, marks=pytest.mark.long)])
def test_piece_in_a_foreign_scene(share, level):
    order = near(scene(0), share)
    piece = moved(noised(marked(scene(0)), level).take(order))
    suspect = merged(piece, scene(1))
    truth = np.concatenate([order, np.full(len(scene(1)), -1)])
    got = register(scene(0), suspect)
    check(got, truth, exact=0.97 if level else 0.999, degrees=0.5, scale=0.01, false=0.01)


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in (2, 3))])
def test_unrelated(seed):
    got = register(scene(0), scene(seed, 9000 + seed))
    assert not got.found
    assert got.derived_fraction == 0
    assert (got.matches == -1).all()
    assert (got.match_quality == 0).all()
    assert got.scale == 1
    np.testing.assert_array_equal(got.R, np.eye(3))


def test_unrelated_to_a_real_scene():
    assert not register(train(), scene(0, 4000, 3)).found
    assert not register(scene(0, 4000, 3), train()).found


@pytest.mark.parametrize("attack", ["shuffle", "crop", "prune", "splat", "noise 0.02", "order noise 0.1"])
def test_real_scene(attack):
    model = marked(train())
    everything = np.arange(len(model))
    order = {"crop": near(model, 0.25), "prune": shuffled(model, 0.2), "order noise 0.1": everything}.get(
        attack, shuffled(model)
    )
    level = float(attack.rsplit(" ", 1)[1]) if "noise" in attack else 0.0
    suspect = noised(splatted(model) if attack == "splat" else model, level).take(order)
    got = register(train(), moved(suspect))
    check(got, order, exact=0.97 if level else 0.99, degrees=2, scale=0.05)


def test_few_gaussians_and_equal_ones_do_not_crash():
    small = scene(0)
    for n in range(6):
        got = register(small.take(np.arange(n)), moved(small.take(np.arange(n))))
        assert got.matches.shape == (n,)
        register(small, small.take(np.arange(n)))
        register(small.take(np.arange(n)), small)
    same = small.take(np.zeros(500, int))
    for suspect in (same, moved(same), small):
        got = register(same, suspect)
        assert got.matches.shape == (len(suspect),)
    assert not register(small, same.take(np.arange(100))).found


def test_flat_and_straight_scenes_do_not_crash():
    model = scene(0, 2000)
    for axes in ([1, 0, 1], [1, 0, 0]):
        flat = model.with_(means=model.means * np.float32(axes))
        register(flat, moved(flat.take(shuffled(flat))))


def test_discs_with_a_third_scale_of_nothing():
    model = scene(0).with_(log_scales=scene(0).log_scales - np.float32([0, 0, 30]))
    order = shuffled(model)
    check(register(model, moved(marked(model).take(order))), order)


def test_scales_out_of_bounds_are_not_believed(monkeypatch):
    narrow = replace(CONFIG.similarity, max_scale=50.0)
    monkeypatch.setattr(locating, "_CONFIG", narrow)
    monkeypatch.setattr(registering, "CONFIG", replace(CONFIG, similarity=narrow))
    order = shuffled(scene(0))
    suspect = moved(marked(scene(0)).take(order), "tiny")
    assert not register(scene(0), suspect).found


def test_same_seed_same_answer_whatever_the_threads():
    suspect = moved(noised(marked(scene(0)), 0.05).take(shuffled(scene(0), 0.5)))
    one, two = with_one_and_two_threads(lambda: register(scene(0), suspect, seed=7))
    for name in ("scale", "R", "t", "matches", "match_quality", "hypotheses_tried"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_an_index_serves_many_suspects():
    index = ReferenceIndex(scene(0))
    suspect = moved(marked(scene(0)).take(shuffled(scene(0), 0.3)))
    first, again = register(index, suspect), register(index, suspect)
    plain = register(scene(0), suspect)
    for got in (again, plain):
        np.testing.assert_array_equal(got.matches, first.matches)
        np.testing.assert_array_equal(got.R, first.R)


def test_the_mark_itself_is_no_part_of_the_match():
    """Two opposite marks are matched alike: the sign of a displacement sways nothing."""
    rng = np.random.default_rng(0)
    order = shuffled(scene(0))
    chips = rng.choice([-0.03, 0.03], (len(scene(0)), 3))
    both = [
        register(scene(0), moved(scene(0).with_dc(scene(0).sh[:, 0] + sign * chips).take(order))) for sign in (1, -1)
    ]
    np.testing.assert_array_equal(both[0].matches, both[1].matches)
