"""transform_model and sh_basis against direct evaluation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from engine.errors import InputError
from engine.model import GaussianModel
from engine.numerics.similarity import (
    MIRROR,
    ODD_IN_X,
    mirror_model,
    quaternion_product,
    quaternion_to_rotation,
    rotation_to_quaternion,
    transform_model,
)
from engine.numerics.spherical_harmonics import sh_basis, sh_rotation
from tests.reference.similarity import covariance, moved_colour, moved_covariance
from tests.reference.spherical_harmonics import sh_colour, sh_value


def random_model(degree: int, n: int = 12, seed: int = 0) -> GaussianModel:
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(n, 4))
    return GaussianModel(
        rng.normal(size=(n, 3)),
        rng.normal(-3, 1, (n, 3)),
        quats / np.linalg.norm(quats, axis=1, keepdims=True),
        rng.normal(size=n),
        rng.normal(size=(n, (degree + 1) ** 2, 3)),
    )


def random_directions(n: int, seed: int = 1) -> np.ndarray:
    d = np.random.default_rng(seed).normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_basis_is_the_textbook_one(degree):
    directions = random_directions(20)
    expected = [[sh_value(l, m, d) for l in range(degree + 1) for m in range(-l, l + 1)] for d in directions]
    np.testing.assert_allclose(sh_basis(directions, degree), expected, atol=1e-12)


def test_basis_keeps_float32():
    assert sh_basis(random_directions(3).astype(np.float32), 3).dtype == np.float32


def test_basis_refuses_degree_4():
    with pytest.raises(InputError, match="4"):
        sh_basis(random_directions(1), 4)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_transform_against_twin(degree):
    model = random_model(degree)
    R = Rotation.random(random_state=3).as_matrix()
    t = np.array([3.0, -2.0, 0.5])
    moved = transform_model(model, 0.37, R, t)
    np.testing.assert_allclose(moved.means, model.means.astype(float) @ R.T * 0.37 + t, atol=1e-5)
    np.testing.assert_array_equal(moved.opacity_logits, model.opacity_logits)
    np.testing.assert_allclose(np.linalg.norm(moved.quats, axis=1), 1, atol=1e-6)
    for i in range(len(model)):
        expected = moved_covariance(model, i, 0.37, R)
        np.testing.assert_allclose(covariance(moved, i), expected, atol=1e-5 * np.trace(expected))
        for d in random_directions(5, seed=i):
            colour = sh_colour(moved.sh[i].astype(float), d)
            np.testing.assert_allclose(colour, moved_colour(model, i, R, d), atol=2e-5)


def test_round_trip_and_composition():
    model = random_model(3)
    A, B = Rotation.random(2, random_state=5).as_matrix()
    t = np.array([1.0, 2.0, 3.0])
    there = transform_model(model, 7.0, A, t)
    back = transform_model(there, 1 / 7.0, A.T, -A.T @ t / 7.0)
    np.testing.assert_allclose(back.means, model.means, atol=1e-5)
    np.testing.assert_allclose(back.log_scales, model.log_scales, atol=1e-5)
    np.testing.assert_allclose(back.sh, model.sh, atol=1e-5)
    np.testing.assert_allclose(np.abs((back.quats * model.quats).sum(1)), 1, atol=1e-6)
    np.testing.assert_allclose(sh_rotation(A @ B, 3), sh_rotation(A, 3) @ sh_rotation(B, 3), atol=1e-12)


def test_sh_rotation_is_orthogonal():
    D = sh_rotation(Rotation.random(random_state=9).as_matrix(), 3)
    np.testing.assert_allclose(D @ D.T, np.eye(16), atol=1e-12)


def test_quaternions_and_matrices_agree():
    A, B = Rotation.random(2, random_state=5).as_matrix()
    p, q = rotation_to_quaternion(A), rotation_to_quaternion(B)
    np.testing.assert_allclose(quaternion_to_rotation(quaternion_product(p, q)), A @ B, atol=1e-12)


def test_quaternions_of_matrices_are_scipys():
    """Of any turn, and of half turns, which have no real part."""
    turns = [Rotation.random(300, random_state=6), Rotation.create_group("O"), Rotation.from_rotvec(np.pi * np.eye(3))]
    for R in turns:
        wanted = np.roll(R.as_quat(canonical=True), 1, axis=1)
        np.testing.assert_allclose(rotation_to_quaternion(R.as_matrix()), wanted, atol=1e-12)
    assert rotation_to_quaternion(turns[1].as_matrix().reshape(4, 6, 3, 3)).shape == (4, 6, 4)


def test_identity_changes_no_bit():
    model = random_model(3)
    same = transform_model(model, 1.0, np.eye(3), np.zeros(3))
    for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
        np.testing.assert_array_equal(getattr(same, name), getattr(model, name))


@pytest.mark.parametrize(
    ("scale", "R", "t"),
    [
        (0.0, np.eye(3), np.zeros(3)),
        (float("nan"), np.eye(3), np.zeros(3)),
        (1.0, np.diag([1.0, 1.0, -1.0]), np.zeros(3)),
        (1.0, 2 * np.eye(3), np.zeros(3)),
        (1.0, np.eye(3), np.zeros(2)),
        (1.0, np.eye(3), np.array([0, np.inf, 0])),
    ],
)
def test_what_is_no_similarity_is_refused(scale, R, t):
    with pytest.raises(InputError):
        transform_model(random_model(1), scale, R, t)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_mirror_image_has_mirrored_covariances_and_colours(degree):
    model = random_model(degree)
    image = mirror_model(model)
    flip = np.diag(MIRROR).astype(float)
    for i in range(len(model)):
        np.testing.assert_allclose(image.means[i], flip @ model.means[i])
        own, theirs = (covariance(m, i) for m in (model, image))
        np.testing.assert_allclose(theirs, flip @ own @ flip, rtol=1e-4, atol=1e-8)
        for d in random_directions(5):
            np.testing.assert_allclose(sh_colour(image.sh[i], flip @ d), sh_colour(model.sh[i], d), atol=1e-5)
    assert image.log_scales is model.log_scales
    assert image.opacity_logits is model.opacity_logits
    assert not np.shares_memory(image.sh, model.sh)


def test_harmonics_that_are_odd_in_x():
    directions = random_directions(20)
    ratio = sh_basis(directions * MIRROR, 3) / sh_basis(directions, 3)
    np.testing.assert_allclose(ratio, np.broadcast_to(np.where(np.isin(np.arange(16), ODD_IN_X), -1, 1), (20, 16)))
