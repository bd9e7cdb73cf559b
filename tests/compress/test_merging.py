from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from engine.compress.pruning import covariances, merge_duplicates
from engine.model import GaussianModel
from engine.numerics.gaussians import flatten


def scattered(n: int = 200) -> GaussianModel:
    rng = np.random.default_rng(5)
    quats = rng.standard_normal((n, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return GaussianModel(
        rng.uniform(-10, 10, (n, 3)),
        rng.uniform(-3, -2, (n, 3)),
        quats,
        rng.standard_normal(n),
        rng.standard_normal((n, 4, 3)),
    )


def test_exact_duplicates_merge_into_the_original() -> None:
    model = scattered()
    twice = GaussianModel(
        *(
            np.concatenate([a, a[:50]])
            for a in (model.means, model.log_scales, model.quats, model.opacity_logits, model.sh)
        )
    )
    merged, kept, partner = merge_duplicates(twice, 0.05)
    assert len(merged) == 200
    np.testing.assert_array_equal(kept, np.arange(200))
    np.testing.assert_array_equal(partner[:50], np.arange(200, 250))
    np.testing.assert_allclose(merged.means, model.means, atol=1e-5)
    np.testing.assert_allclose(covariances(merged), covariances(model), rtol=2e-3, atol=1e-7)
    expected = 1 - (1 - model.opacities[:50]) ** 2
    np.testing.assert_allclose(merged.opacities[:50], expected, atol=1e-5)
    np.testing.assert_array_equal(merged.sh[50:], model.sh[50:])


def test_scattered_gaussians_stay() -> None:
    model = scattered()
    merged, _, partner = merge_duplicates(model, 0.05)
    assert len(merged) == len(model)
    assert (partner < 0).all()


def test_other_color_or_shape_stays() -> None:
    model = scattered(2)
    pair = model.with_(means=np.zeros((2, 3)), log_scales=np.full((2, 3), -2.0), quats=np.tile([1.0, 0, 0, 0], (2, 1)))
    recolored = pair.with_(sh=np.stack([np.zeros((4, 3)), np.ones((4, 3))]))
    reshaped = pair.with_(sh=np.zeros((2, 4, 3)), log_scales=np.array([[-2.0] * 3, [-2.0, -2.0, -4.0]]))
    assert len(merge_duplicates(recolored, 0.05)[0]) == 2
    assert len(merge_duplicates(reshaped, 0.05)[0]) == 2
    assert len(merge_duplicates(pair.with_(sh=np.zeros((2, 4, 3))), 0.05)[0]) == 1


def test_merged_discs_are_discs() -> None:
    discs = flatten(scattered())
    near = discs.take(np.arange(50))
    near = near.with_(means=near.means + 1e-4 * np.random.default_rng(0).standard_normal((50, 3)))
    near = near.with_(means=near.means.astype(np.float32))
    twice = GaussianModel(
        *(
            np.concatenate([getattr(discs, n), getattr(near, n)])
            for n in ("means", "log_scales", "quats", "opacity_logits", "sh")
        )
    )
    merged, _, partner = merge_duplicates(twice, 1e9)
    assert (partner >= 0).sum() == 50
    assert merged.is_flat
    untouched = partner < 0
    np.testing.assert_array_equal(merged.quats[untouched], twice.quats[:200][untouched])
    np.testing.assert_allclose(covariances(merged), covariances(discs), rtol=5e-3, atol=1e-6)


def test_a_merged_pair_has_the_first_two_moments_of_both() -> None:
    """Two unlike Gaussians, weighted by opacity as a mixture is."""
    rng = np.random.default_rng(6)
    quats = rng.standard_normal((1, 4)).repeat(2, axis=0) + 0.02 * rng.standard_normal((2, 4))
    pair = GaussianModel(
        np.array([[1.0, 2.0, 3.0], [1.02, 2.01, 2.99]]),
        np.array([[-2.0, -2.5, -3.0], [-2.1, -2.45, -3.05]]),
        quats / np.linalg.norm(quats, axis=1, keepdims=True),
        np.array([-1.0, 2.0]),
        np.stack([np.full((4, 3), 0.1), np.full((4, 3), 0.2)]),
    )
    merged, kept, partner = merge_duplicates(pair, 0.5)
    assert (kept.tolist(), partner.tolist()) == ([0], [1])
    share = pair.opacities.astype(np.float64) / pair.opacities.sum()
    mean = share @ pair.means.astype(np.float64)
    gaps = pair.means - mean
    spread = np.einsum("n,nij->ij", share, covariances(pair) + gaps[:, :, None] * gaps[:, None, :])
    np.testing.assert_allclose(merged.means[0], mean, rtol=1e-6)
    np.testing.assert_allclose(covariances(merged)[0], spread, rtol=1e-4, atol=1e-8)
    np.testing.assert_allclose(merged.sh[0], np.full((4, 3), share @ [0.1, 0.2]), rtol=1e-5)
    assert np.linalg.det(Rotation.from_quat(merged.quats[0][[1, 2, 3, 0]]).as_matrix()) > 0


def test_covariances_are_those_of_the_definition() -> None:
    model = scattered(5)
    for i, (w, x, y, z) in enumerate(model.quats.astype(np.float64)):
        R = Rotation.from_quat([x, y, z, w]).as_matrix()
        S = np.diag(np.exp(model.log_scales[i].astype(np.float64)))
        np.testing.assert_allclose(covariances(model)[i], R @ S @ S.T @ R.T, rtol=1e-6)


def test_of_three_in_a_row_the_two_nearest_merge() -> None:
    model = scattered(3)
    row = model.with_(
        means=np.array([[0.03, 0, 0], [0, 0, 0], [0.01, 0, 0]]),
        log_scales=np.full((3, 3), -1.0),
        quats=np.tile([1.0, 0, 0, 0], (3, 1)),
        sh=np.zeros((3, 4, 3)),
    )
    merged, kept, partner = merge_duplicates(row, 0.05)
    assert (kept.tolist(), partner.tolist()) == ([0, 1], [-1, 2])
    np.testing.assert_array_equal(merged.means[0], row.means[0])
