"""The blocks' transform against SciPy's."""

from __future__ import annotations

import numpy as np
import scipy.fft

from engine.pictures.jpeg.coded_blocks import inverse_transform, tiles, transform


def test_it_is_scipys_and_goes_back() -> None:
    blocks = np.random.default_rng(0).uniform(-128.0, 127.0, (5, 7, 8, 8))
    before = blocks.copy()
    there = transform(blocks)
    np.testing.assert_allclose(there, scipy.fft.dctn(blocks, axes=(2, 3), norm="ortho"), atol=1e-11)
    np.testing.assert_allclose(inverse_transform(there), blocks, atol=1e-11)
    np.testing.assert_array_equal(blocks, before)


def test_it_takes_views_of_single_precision() -> None:
    picture = np.random.default_rng(1).uniform(0.0, 255.0, (24, 20)).astype(np.float32)
    there = transform(tiles(picture))
    assert there.shape == (3, 2, 8, 8)
    assert there.dtype == np.float64
    np.testing.assert_allclose(there[..., 0, 0], 8.0 * tiles(picture).mean(axis=(2, 3), dtype=np.float64), rtol=1e-6)


def test_nothing_is_nothing() -> None:
    assert transform(np.zeros((0, 8, 8))).shape == (0, 8, 8)
