"""A model placed by what it looks like, its Gaussians unknown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from engine.flows.verify import appearance_search as looking
from engine.flows.verify.appearance_search import Sighting, place_by_looking
from engine.flows.views.camera_rig import make_rig
from engine.model import Camera, GaussianModel, look_at
from engine.numerics.similarity import mirror_model, transform_model
from engine.numerics.umeyama import Similarity
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.pictures.landmarks.rendered_landmarks import make_landmarks
from engine.raster import render
from tests.registration.registration_cases import MOVES
from tests.registration.registration_cases import scene as made_up


@pytest.fixture(scope="module")
def model(plant: GaussianModel) -> GaussianModel:
    part = plant.take(np.arange(0, len(plant), 3))
    return part.with_(log_scales=part.log_scales + np.float32(0.25))  # closes the gaps


@pytest.fixture(scope="module")
def landmarks(model: GaussianModel) -> Landmarks:
    return make_landmarks(model, make_rig(model, 12, 640, 480))


@pytest.mark.slow
@pytest.mark.parametrize("move", ["small"])
def test_the_place_found_by_looking_is_exact(model: GaussianModel, landmarks: Landmarks, move: str) -> None:
    scale, R, t = MOVES[move]
    place = place_by_looking(transform_model(model, scale, R, t), model, landmarks)
    assert place is not None
    assert len(place.sightings) >= 2
    assert place.similarity.scale * scale == pytest.approx(1.0, abs=0.003)
    assert np.trace(place.similarity.R @ R) == pytest.approx(3.0, abs=1e-4)
    back = place.similarity.apply(scale * model.means @ R.T + t)
    assert np.median(np.linalg.norm(back - model.means, axis=1)) < 2e-3 * np.ptp(model.means)


@pytest.mark.long
@pytest.mark.slow
def test_a_mirrored_model_is_placed_by_its_mirror_image(model: GaussianModel, landmarks: Landmarks) -> None:
    scale, R, t = MOVES["small"]
    suspect = transform_model(mirror_model(model), scale, R, t)
    place = place_by_looking(suspect, model, landmarks)
    assert place is not None
    assert place.mirrored
    gap = np.linalg.norm(place.place(suspect).means - model.means, axis=1)
    assert np.median(gap) < 2e-3 * np.ptp(model.means)
    sighting = place.sightings[0]
    assert np.abs(render(mirror_model(suspect), sighting.own) - sighting.picture).mean() < 1e-3


def test_a_mirrored_camera_sees_the_mirror_image_turned_over() -> None:
    model = made_up(2, 300, 3)
    camera = look_at((7.0, -3.0, -9.0), (0.5, 0.2, 0), (0.1, -1, 0), 60.0, 64, 48)
    camera = Camera(camera.viewmat, camera.K + np.float64([[0, 0, 5], [0, 0, -3], [0, 0, 0]]), 64, 48)
    there = render(mirror_model(model), looking.mirrored_camera(camera))
    np.testing.assert_allclose(there[:, ::-1], render(model, camera), atol=1e-3)
    assert there.std() > 0.02


def test_sightings_of_both_hands_are_never_of_one_place() -> None:
    mixed = sightings(0)
    mixed[0] = replace(mixed[0], mirrored=True)
    assert [id(s) for s in looking._most_agreeing(mixed)] == [id(s) for s in mixed[1:]]


@pytest.mark.long
@pytest.mark.slow
def test_another_scene_is_not_recognised(model: GaussianModel, landmarks: Landmarks) -> None:
    assert place_by_looking(made_up(1, degree=0), model, landmarks) is None


def sightings(wrong: int) -> list[Sighting]:
    """Three views of one place, and some that were taken for another one, each elsewhere."""
    rng = np.random.default_rng(0)
    true = Similarity(2.0, Rotation.from_euler("xyz", [0.3, -0.2, 0.5]).as_matrix(), np.array([1.0, -2.0, 0.5]))
    made = []
    for k in range(3 + wrong):
        own = look_at(rng.standard_normal(3) * 4, (0, 0, 0), (0, -1, 0), 300.0, 64, 48)
        turn = Rotation.from_euler("y", 0.0 if k < 3 else 0.4 * (k - 1)).as_matrix()
        R = turn @ true.R
        viewmat = np.eye(4)
        viewmat[:3, :3] = own.viewmat[:3, :3] @ R.T
        position = true.scale * R @ own.position + true.t
        viewmat[:3, 3] = -viewmat[:3, :3] @ position
        made.append(Sighting(np.zeros((48, 64, 3), np.float32), own, Camera(viewmat, own.K, 64, 48), 1.5, 3.0))
    return made


def test_a_sighting_is_a_whole_similarity() -> None:
    found = sightings(0)[0].similarity
    assert found.scale == pytest.approx(2.0)
    np.testing.assert_allclose(found.apply(np.zeros((1, 3)))[0], [1.0, -2.0, 0.5], atol=1e-9)


def test_sightings_that_were_mistaken_are_outvoted() -> None:
    mixed = sightings(2)[::-1]  # the wrong ones first
    agreeing = looking._most_agreeing(mixed)
    assert [id(s) for s in agreeing] == [id(s) for s in mixed[2:]]


def test_one_sighting_is_not_enough(plant: GaussianModel, monkeypatch: pytest.MonkeyPatch) -> None:
    once = iter(sightings(0)[:1])
    monkeypatch.setattr(looking, "_look", lambda *_: next(once, None))
    small = plant.take(np.arange(0, len(plant), 100))
    assert place_by_looking(small, small, None) is None  # type: ignore[arg-type]
