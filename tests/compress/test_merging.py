from __future__ import annotations

import numpy as np

from engine.compress.merging import covariances, merge_duplicates
from engine.model import GaussianModel
from engine.numerics.flattening import flatten


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
