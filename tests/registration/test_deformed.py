"""Suspects that no similarity explains: bent, twisted, squashed, posed. See `registration_deformed`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.formats import read_model
from engine.model import GaussianModel
from engine.registration.looks_index import ReferenceIndex
from engine.registration.patches import apply, blend, fit_affine, warped
from engine.registration.registration_search import Registration, RegistrationConfig, register
from tests.registration.deformation_cases import CASES, bend, squash, twist
from tests.registration.registration_cases import TRAIN, marked, merged, moved, near, noised, scene, shuffled

pytestmark = pytest.mark.slow

PLANT = TRAIN.parent / "plant.splat"
RIGID = RegistrationConfig(deformed=False)


@pytest.fixture(scope="module")
def plant() -> ReferenceIndex:
    """A twelfth of a real scene."""
    model = read_model(PLANT).model
    return ReferenceIndex(model.take(np.arange(0, len(model), 12)))


def share_right(got: Registration, order: np.ndarray) -> tuple[float, float]:
    """Share of the suspect's own Gaussians matched rightly, and of the matches that are right."""
    right = (got.matches == order) & (order >= 0)
    return float(right.sum() / (order >= 0).sum()), float(right.sum() / max(1, (got.matches >= 0).sum()))


@pytest.mark.parametrize(
    ("case", "more"),
    [
        pytest.param("bend 90", 0.3, marks=pytest.mark.long),
        pytest.param("squash 0.5", 0.6, marks=pytest.mark.long),
        pytest.param("articulate 45", 0.2, marks=pytest.mark.long),
    ],
)
def test_deformed_real_scene(plant: ReferenceIndex, case: str, more: float) -> None:
    order = shuffled(plant.model)
    suspect = moved(CASES[case](marked(plant.model)).take(order))
    alone, got = register(plant, suspect, config=RIGID), register(plant, suspect)
    recall, precision = share_right(got, order)
    assert got.deformed
    assert not alone.deformed
    assert recall > max(0.75, share_right(alone, order)[0] + more)
    assert precision > 0.99
    assert got.derived_fraction == pytest.approx(recall, abs=0.02)


def test_squashed_crop_and_bent_piece_in_a_foreign_scene(plant: ReferenceIndex) -> None:
    order = near(plant.model, 0.2)
    got = register(plant, moved(squash(marked(plant.model), 0.5).take(order)))
    assert min(share_right(got, order)) > 0.95
    foreign = scene(1)
    truth = np.concatenate([np.arange(len(plant.model)), np.full(len(foreign), -1)])
    got = register(plant, merged(moved(bend(marked(plant.model), 60)), foreign.with_(sh=foreign.sh[:, :1])))
    recall, precision = share_right(got, truth)
    assert recall > 0.75
    assert precision > 0.99
    assert (got.matches[truth < 0] >= 0).mean() < 0.01


@pytest.mark.parametrize("suspect", ["as it is", "cropped", "noisy", "in a foreign scene"])
def test_suspects_that_a_similarity_explains_keep_it(plant: ReferenceIndex, suspect: str) -> None:
    model = marked(plant.model)
    changed = {
        "as it is": model,
        "cropped": model.take(near(model, 0.3)),
        "noisy": noised(model, 0.05).take(shuffled(model)),
        "in a foreign scene": merged(model.take(shuffled(model)), scene(1).with_(sh=scene(1).sh[:, :1])),
    }[suspect]
    got, alone = register(plant, moved(changed)), register(plant, moved(changed), config=RIGID)
    assert not got.deformed
    np.testing.assert_array_equal(got.matches, alone.matches)


def test_foreign_scenes_have_no_piece_of_the_reference(plant: ReferenceIndex) -> None:
    rng = np.random.default_rng(0)
    # the hardest stranger: the scene's own Gaussians, each with the looks of another
    swapped = plant.model.take(rng.permutation(len(plant.model))).with_(means=plant.model.means)
    for stranger in (scene(1), swapped, squash(scene(2), 0.5)):
        got = register(plant, stranger)
        assert not got.found
        assert got.derived_fraction == 0


@pytest.mark.long
def test_the_mark_itself_is_no_part_of_the_match(plant: ReferenceIndex) -> None:
    """Two opposite marks are matched nearly alike, and chance differences do not know the sign."""
    rng = np.random.default_rng(0)
    order = shuffled(plant.model)
    chips = rng.choice([-0.03, 0.03], (len(plant.model), 3))
    both = [
        register(plant, squash(plant.model.with_dc(plant.model.sh[:, 0] + s * chips), 0.5).take(order)) for s in (1, -1)
    ]
    for got in both:
        assert share_right(got, order)[1] > 0.999
    differing = both[0].matches != both[1].matches
    assert differing.mean() < 0.001


@pytest.mark.long
def test_same_seed_same_answer(plant: ReferenceIndex) -> None:
    suspect = moved(twist(marked(plant.model), 60).take(shuffled(plant.model)))
    first, again = register(plant, suspect, seed=3), register(ReferenceIndex(plant.model), suspect, seed=3)
    np.testing.assert_array_equal(first.matches, again.matches)
    np.testing.assert_array_equal(first.match_quality, again.match_quality)
    assert first.hypotheses_tried == again.hypotheses_tried


def test_small_and_degenerate_suspects_do_not_crash() -> None:
    model = scene(0, 2000)
    for n in (3, 20, 100):
        register(model, squash(model, 0.3).take(np.arange(n)))
    flat = model.with_(means=model.means * np.float32([1, 0, 1]))
    register(flat, flat.with_(means=flat.means * np.float32([1, 1, 0.4])).take(shuffled(flat)))


def _pairs(rng: np.random.Generator, map_: np.ndarray, flat: bool) -> tuple[np.ndarray, np.ndarray]:
    source = rng.normal(size=(1, 60, 3)) * ([1, 1, 0] if flat else [1, 1, 1])
    return source, apply(map_[None, None], source)


def test_affine_fit_is_exact_robust_and_carries_flat_pieces_along() -> None:
    rng = np.random.default_rng(0)
    map_ = np.concatenate([np.diag([1.2, 0.8, 1.0]) @ np.linalg.qr(rng.normal(size=(3, 3)))[0], [[1], [2], [3]]], 1)
    map_[:, :3] *= np.sign(np.linalg.det(map_[:, :3]))
    source, target = _pairs(rng, map_, flat=False)
    np.testing.assert_allclose(fit_affine(source, target, map_[None])[0], map_, atol=1e-9)
    target[0, :6] += 5.0  # one in ten is wrong
    np.testing.assert_allclose(fit_affine(source, target, map_[None])[0], map_, atol=0.02)
    # a flat piece says nothing across it: the prior, turned along with the piece, does
    start = np.concatenate([np.eye(3), np.zeros((3, 1))], axis=1)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    source, target = _pairs(rng, np.concatenate([turn, np.ones((3, 1))], axis=1), flat=True)
    np.testing.assert_allclose(fit_affine(source, target, start[None])[0][:, :3], turn, atol=1e-6)


def test_blended_maps_agree_with_their_nodes_and_are_smooth() -> None:
    rng = np.random.default_rng(0)
    nodes = rng.normal(size=(50, 3))
    one = np.concatenate([rng.normal(size=(3, 3)), rng.normal(size=(3, 1))], axis=1)
    np.testing.assert_allclose(blend(nodes, np.broadcast_to(one, (50, 3, 4)), nodes + 0.1)[7], one)
    maps = rng.normal(size=(50, 3, 4))
    step = 1e-5 * rng.normal(size=(50, 3))
    points = rng.normal(size=(50, 3))
    gap = np.abs(blend(nodes, maps, points + step) - blend(nodes, maps, points)).max()
    assert 0 < gap < 0.01


def test_warped_covariances_are_those_of_the_map() -> None:
    model = scene(0, 50)
    stretch = np.broadcast_to(np.diag([2.0, 1.0, 0.5, 0])[:3].copy(), (50, 3, 4))
    got: GaussianModel = warped(model, stretch)
    truth = squash(model.with_(means=model.means), 1.0)  # sorts the axes, changes nothing
    np.testing.assert_allclose(np.sort(truth.log_scales, 1), np.sort(model.log_scales, 1), atol=1e-3)
    volume = got.log_scales.sum(axis=1) - model.log_scales.sum(axis=1)
    np.testing.assert_allclose(volume, 0.0, atol=1e-3)  # 2 * 1 * 0.5
    assert np.abs(np.sort(got.log_scales, 1) - np.sort(model.log_scales, 1)).max() > 0.3
    assert replace(got).sh is got.sh
