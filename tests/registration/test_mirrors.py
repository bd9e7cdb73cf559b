"""Mirrored suspects are registered as if they were not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from engine.model import GaussianModel
from engine.numerics.similarity import mirror_model, transform_model
from engine.registration.registration_search import Registration, RegistrationConfig, register
from tests.registration.deformation_cases import bend
from tests.registration.registration_cases import marked, merged, moved, near, noised, rounded, scene, shuffled

RIGID = RegistrationConfig(deformed=False)
NORMALS = {"x": [1.0, 0, 0], "y": [0, 1.0, 0], "z": [0, 0, 1.0], "slanted": [0.48, -0.6, 0.64]}


def mirrored_by_hand(model: GaussianModel, normal: list[float]) -> GaussianModel:
    """Centres and covariances reflected at the plane through the origin, written out: H = 1 - 2 n n^T. Colours keep the
    DC alone, which no plane changes."""
    n = np.asarray(normal)
    H = np.eye(3) - 2.0 * np.outer(n, n)
    R = Rotation.from_quat(np.roll(model.quats, -1, axis=1)).as_matrix()
    axes = H @ R
    axes[:, :, 0] *= -1  # any axis of an ellipsoid may be turned round: the frame is right-handed again
    quats = np.roll(Rotation.from_matrix(axes).as_quat(), 1, axis=1)
    return model.with_(means=model.means @ H, quats=quats, sh=model.sh[:, :1])


def check(got: Registration, truth: np.ndarray, reference: GaussianModel, suspect: GaussianModel, least: float) -> None:
    """Found as a mirror image; the suspect, placed, lies on its originals."""
    assert got.found
    assert got.mirrored
    assert np.linalg.det(got.R) == pytest.approx(1.0)
    ours = truth >= 0
    assert (got.matches[ours] == truth[ours]).mean() >= least
    gap = np.linalg.norm(got.place(suspect).means[ours] - reference.means[truth[ours]], axis=1)
    assert np.median(gap) < 0.2 * reference.means.std()


@pytest.mark.parametrize("normal", NORMALS)
def test_a_mirror_in_any_plane_in_order_and_out_of_it(normal: str) -> None:
    model = scene(0)
    suspect = mirrored_by_hand(marked(model), NORMALS[normal])
    check(register(model, suspect, config=RIGID), np.arange(len(model)), model, suspect, 0.999)
    order = shuffled(model, 0.7)
    part = rounded(suspect.take(order))
    got = register(model, part, config=RIGID)
    check(got, order, model, part, 0.999)
    assert (got.hypotheses_tried <= 48) == (normal != "slanted")  # axis planes need no search
    assert got.derived_fraction == pytest.approx(0.7, abs=0.01)


@pytest.mark.parametrize("share", [1.0, 0.1])
def test_a_mirror_and_a_similarity(share: float) -> None:
    model = scene(0)
    order = near(model, share)
    suspect = moved(mirror_model(marked(model)).take(order))
    got = register(model, suspect, config=RIGID)
    check(got, order, model, suspect, 0.999)
    placed = got.place(suspect)
    np.testing.assert_allclose(placed.sh[:, 1:], model.sh[order, 1:], atol=1e-4)
    assert (np.abs((placed.quats * model.quats[order]).sum(axis=1)) > 1 - 1e-5).all()


def test_a_mirror_thinned_and_noised() -> None:
    """Four fifths kept, centres off by a tenth of their spread, sizes and opacities a little."""
    model = scene(0)
    rng = np.random.default_rng(1)
    order = shuffled(model, 0.8)
    part = mirror_model(marked(model)).take(order)
    suspect = part.with_(
        means=part.means + 0.1 * part.means.std(axis=0) * rng.normal(size=part.means.shape),
        log_scales=part.log_scales + rng.normal(0, 0.05, part.log_scales.shape),
        opacity_logits=part.opacity_logits + rng.normal(0, 0.2, len(part)),
    )
    check(register(model, moved(suspect), config=RIGID), order, model, moved(suspect), 0.95)


def test_one_that_is_not_mirrored_is_not_called_so() -> None:
    model = scene(0)
    for suspect in (marked(model), marked(model).take(shuffled(model)), noised(model, 0.1).take(shuffled(model))):
        got = register(model, moved(suspect), config=RIGID)
        assert got.found
        assert not got.mirrored


def test_rotations_that_tell_nothing_do_not_hide_a_mirror() -> None:
    """Axes of each ellipsoid listed in another order: only where the Gaussians lie tells the hands apart."""
    model = scene(0)
    order = shuffled(model)
    rng = np.random.default_rng(3)
    part = mirror_model(marked(model)).take(order)
    quats = rng.normal(size=part.quats.shape)
    suspect = moved(part.with_(quats=quats / np.linalg.norm(quats, axis=1, keepdims=True)))
    check(register(model, suspect, config=RIGID), order, model, suspect, 0.99)


@pytest.mark.parametrize("straight", [0.05, 0.7])
def test_of_two_hands_the_larger_piece_is_read(straight: float) -> None:
    """A small piece left as it was does not hide the mirror, nor the other way round."""
    model = scene(0)
    order = shuffled(model)
    cut = int(straight * len(model))
    plain, rest = marked(model).take(order[:cut]), mirror_model(marked(model)).take(order[cut:])
    for move in ("small", "z-up"):
        got = register(model, merged(moved(plain, move), moved(rest, move)), config=RIGID)
        assert got.mirrored == (straight < 0.5)
        mine = np.arange(len(model)) >= cut if got.mirrored else np.arange(len(model)) < cut
        assert (got.matches[mine] == order[mine]).mean() > 0.99


def test_a_piece_left_in_place_hides_no_mirror_elsewhere() -> None:
    """The piece is found at once, where the reference lies; the rest must be looked for all the same."""
    model = scene(0)
    order = shuffled(model)
    cut = len(model) // 20
    rest = moved(mirror_model(marked(model)).take(order[cut:]))
    got = register(model, merged(marked(model).take(order[:cut]), rest), config=RIGID)
    assert got.mirrored
    assert (got.matches[cut:] == order[cut:]).mean() > 0.99


@pytest.mark.long
@pytest.mark.slow
def test_a_mirror_that_is_bent() -> None:
    model = scene(0, degree=0)
    order = shuffled(model)
    suspect = moved(mirror_model(bend(marked(model), 30)).take(order))
    got = register(model, suspect)
    assert got.deformed
    assert got.mirrored
    assert (got.matches == order).mean() > 0.75
    straight = register(model, mirror_model(suspect))
    assert straight.deformed
    assert not straight.mirrored
    assert (straight.matches == order).mean() > 0.75
    further = register(model, moved(mirror_model(bend(marked(model), 90)).take(order)))
    assert (further.matches == order).mean() > 0.75, "bent so far, which hand it is cannot be told"


@pytest.mark.long
def test_foreign_scenes_are_not_found_in_a_mirror() -> None:
    for seed in (1, 2):
        assert not register(scene(0), mirror_model(moved(scene(seed, 9000)))).found


def test_the_mark_chooses_no_hand() -> None:
    """Two opposite marks: the same hand, the same matches."""
    model = scene(0)
    chips = np.random.default_rng(0).choice([-0.03, 0.03], (len(model), 3))
    order = shuffled(model)
    one, two = (
        register(model, moved(mirror_model(model.with_dc(model.sh[:, 0] + s * chips)).take(order)), config=RIGID)
        for s in (1, -1)
    )
    assert one.mirrored
    assert two.mirrored
    assert (one.matches != two.matches).mean() < 0.001


def test_a_mirrored_model_moved_twice_is_where_it_was() -> None:
    model = scene(0, 500, 3)
    there = mirror_model(model)
    back = mirror_model(there)
    for name in ("means", "quats", "sh"):
        np.testing.assert_array_equal(getattr(back, name), getattr(model, name))
    turned = transform_model(there, 1.0, np.diag([-1.0, -1.0, 1.0]), np.zeros(3))  # x and y: in all, y alone
    np.testing.assert_allclose(turned.means, model.means * [1, -1, 1])
