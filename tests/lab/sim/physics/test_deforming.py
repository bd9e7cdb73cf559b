"""F Sigma F^T, polar rotations and turned harmonics, against the slow twin and on the matrices that break others."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.sim.physics.deforming import deform_covariances, deform_model, polar_rotations, rotation_parts, turn_sh
from engine.model import GaussianModel, look_at
from engine.numerics.image_metrics import psnr
from engine.numerics.similarity import quaternion_to_rotation, transform_model
from engine.numerics.spherical_harmonics import sh_basis
from engine.raster import render
from tests.reference.deformation import deformed_colour, deformed_covariance, nearest_rotation
from tests.reference.similarity import covariance
from tests.threads import with_one_and_two_threads

ATTRIBUTES = ("means", "log_scales", "quats", "opacity_logits", "sh")


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    q = rng.standard_normal(4)
    return quaternion_to_rotation(q / np.linalg.norm(q))


def gradients(count: int, seed: int = 0) -> np.ndarray:
    """Strong deformations that do not mirror."""
    rng = np.random.default_rng(seed)
    stretches = np.exp(rng.normal(0.0, 0.7, (count, 3)))
    turns = [(random_rotation(rng), random_rotation(rng)) for _ in range(count)]
    return np.stack([a @ np.diag(s) @ b for (a, b), s in zip(turns, stretches, strict=True)])


def test_covariances_match_the_twin(ball: GaussianModel) -> None:
    F = gradients(40)
    element = np.random.default_rng(1).integers(40, size=len(ball))
    moved = deform_model(ball, ball.means, F, element)
    for i in range(0, len(ball), 7):
        expected = deformed_covariance(ball, i, F[element[i]])
        np.testing.assert_allclose(covariance(moved, i), expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())
    np.testing.assert_allclose(np.linalg.norm(moved.quats, axis=1), 1.0, atol=1e-6)
    assert np.abs(moved.log_scales - ball.log_scales).max() > 0.5


def test_colors_match_the_twin(ball: GaussianModel) -> None:
    F = gradients(30, seed=2)
    element = np.arange(len(ball)) % 30
    moved = deform_model(ball, ball.means, F, element)
    direction = np.array([0.36, -0.48, 0.8])
    seen = 0.5 + np.einsum("k,nkc->nc", sh_basis(direction, 3), moved.sh.astype(np.float64))
    for i in range(0, len(ball), 29):
        np.testing.assert_allclose(seen[i], deformed_colour(ball, i, F[element[i]], direction), atol=1e-5)


def test_more_gradients_than_a_batch_are_each_their_own_gaussians(ball: GaussianModel) -> None:
    many = GaussianModel(*(np.tile(getattr(ball, n), (40, *[1] * (getattr(ball, n).ndim - 1))) for n in ATTRIBUTES))
    F = np.concatenate([gradients(600, seed=5)] * 40)
    F[20_000:] = F[20_000:, ::-1] * [[-1.0], [1.0], [1.0]]  # not the same in every batch
    moved = deform_model(many, many.means, F)
    for i in (0, 16_383, 16_384, 21_111, len(many) - 1):
        alone = deform_model(many.take(np.array([i])), many.means[[i]], F[[i]])
        for name in ATTRIBUTES:
            np.testing.assert_array_equal(getattr(moved, name)[i], getattr(alone, name)[0])


def test_polar_rotations_match_scipy() -> None:
    F = gradients(200, seed=3)
    for rotation, f in zip(polar_rotations(F), F, strict=True):
        np.testing.assert_allclose(rotation, nearest_rotation(f), atol=1e-12)


def degenerate_gradients() -> dict[str, np.ndarray]:
    a, b = gradients(2, seed=4)
    return {
        "zero": np.zeros((3, 3)),
        "line": np.outer(a[0], b[1]),
        "plane": a @ np.diag([1.0, 2.0, 0.0]) @ b,
        "mirror": np.diag([1.0, 1.0, -1.0]),
        "inverted": a @ np.diag([1.0, 2.0, -0.3]) @ b,
        "point mirror": -np.eye(3),
        "nearly flat": a @ np.diag([1.0, 1e-9, 1e-12]) @ b,
        "tiny": 1e-200 * a,
        "huge": 1e100 * a,
    }


@pytest.mark.parametrize("name", degenerate_gradients())
def test_degenerate_and_inverted_gradients_give_proper_rotations(name: str, ball: GaussianModel) -> None:
    F = degenerate_gradients()[name]
    R = polar_rotations(F[None])[0]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(R) == pytest.approx(1.0)
    if name == "inverted":  # nothing proper is nearer: the trace of R^T F is largest
        s = np.linalg.svd(F, compute_uv=False)
        assert np.trace(R.T @ F) == pytest.approx(s[0] + s[1] - s[2])
    few = ball.take(np.arange(50))
    moved = deform_model(few, few.means, F[None], np.zeros(50, dtype=np.int64))
    assert all(np.isfinite(getattr(moved, n)).all() for n in ATTRIBUTES if n != "log_scales" or name != "huge")
    if name in ("line", "plane", "mirror", "inverted"):
        for i in range(0, 50, 9):
            expected = deformed_covariance(few, i, F)
            np.testing.assert_allclose(covariance(moved, i), expected, atol=1e-5 * np.abs(expected).max())


def test_no_deformation_changes_nothing(ball: GaussianModel) -> None:
    same = deform_model(ball, ball.means, np.eye(3)[None], np.zeros(len(ball), dtype=np.int64))
    for name in ATTRIBUTES:
        np.testing.assert_allclose(getattr(same, name), getattr(ball, name), atol=1e-6)


def test_disc_of_vanishing_thickness_keeps_its_plane(ball: GaussianModel) -> None:
    discs = ball.with_(log_scales=np.column_stack([ball.log_scales[:, :2], np.full(len(ball), -18.0)]))
    F = gradients(1, seed=8)
    moved = deform_model(discs, discs.means, F, np.zeros(len(ball), dtype=np.int64))
    normal = quaternion_to_rotation(discs.quats)[:, :, 2] @ np.linalg.inv(F[0])  # normals go by F^-T
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    thinnest = np.argmin(moved.log_scales, axis=1)
    found = np.take_along_axis(quaternion_to_rotation(moved.quats), thinnest[:, None, None], axis=2)[:, :, 0]
    np.testing.assert_allclose(np.abs((normal * found).sum(axis=1)), 1.0, atol=1e-6)
    assert moved.log_scales.min() > -21


def test_rigid_motion_renders_as_transform_model_does(ball: GaussianModel) -> None:
    rng = np.random.default_rng(6)
    R, t = random_rotation(rng), np.array([0.3, -0.2, 0.5])
    expected = transform_model(ball, 1.0, R, t)
    moved = deform_model(ball, expected.means, R[None], np.zeros(len(ball), dtype=np.int64))
    center = expected.means.mean(axis=0)
    camera = look_at(center + np.array([0.4, -1.1, 1.6]), center, (0, -1, 0), 110.0, 96, 96)
    picture = render(expected, camera)
    assert psnr(picture, render(moved, camera)) > 80
    assert psnr(picture, render(moved.with_(sh=ball.sh), camera)) < 40  # would notice colors left unturned
    assert psnr(picture, render(moved.with_(quats=ball.quats), camera)) < 40


def test_same_bytes_on_any_number_of_threads(ball: GaussianModel) -> None:
    F = gradients(len(ball), seed=7)
    one, two = with_one_and_two_threads(lambda: deform_model(ball, ball.means, F))
    for name in ATTRIBUTES:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_compiled_kernels_equal_their_formulas(ball: GaussianModel) -> None:
    few = ball.take(np.arange(6))
    F, element = gradients(6, seed=9), np.arange(6, dtype=np.int32)
    wigner = np.random.default_rng(0).standard_normal((6, 16, 16)).astype(np.float32)
    results = []
    for compiled in (True, False):
        a, b, c = np.empty_like(few.log_scales), np.empty_like(few.quats), np.empty_like(few.sh)
        R = np.empty((6, 3, 3))
        for function, arguments in (
            (deform_covariances, (few.log_scales, few.quats, F, element, a, b)),
            (rotation_parts, (F, R)),
            (turn_sh, (few.sh, wigner, element, c)),
        ):
            (function if compiled else function.py_func)(*arguments)
        results.append((a, b, c, R))
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-6)


def test_unfit_input_is_refused(ball: GaussianModel) -> None:
    one = np.eye(3)[None]
    zero = np.zeros(len(ball), dtype=np.int64)
    for arguments, message in (
        ((ball.means, np.eye(3), zero), "shape"),
        ((ball.means, one), "elements"),
        ((ball.means, one, zero + 1), "1 to 1 of 1"),
        ((ball.means, one * np.nan, zero), "finite"),
        ((ball.means * np.inf, one, zero), "finite"),
        ((ball.means[:5], one, zero), "means"),
    ):
        with pytest.raises(InputError, match=message):
            deform_model(ball, *arguments)
