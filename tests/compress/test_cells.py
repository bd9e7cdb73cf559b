from __future__ import annotations

import numpy as np
import pytest

from engine.compress import cells
from engine.model import GaussianModel
from tests.reference.cells import split_cells as slow_split


def blob(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    features = rng.standard_normal((n, 6)).astype(np.float32) * np.array([3, 2, 1, 0.5, 0.2, 0.1], np.float32)
    return features, rng.gamma(0.5, 1.0, n)


@pytest.mark.parametrize(("n", "count"), [(1, 1), (2, 2), (37, 16), (500, 64), (3000, 256)])
def test_agrees_with_slow_twin(n: int, count: int) -> None:
    features, weights = blob(n)
    np.testing.assert_array_equal(
        cells.split_cells(features, weights, count), slow_split(features.astype(np.float64), weights, count)
    )


def test_kernel_without_compiler_agrees(monkeypatch: pytest.MonkeyPatch) -> None:
    features, weights = blob(120)
    fast = cells.split_cells(features, weights, 16)
    monkeypatch.setattr(cells, "_split_level", cells._split_level.py_func)
    np.testing.assert_array_equal(cells.split_cells(features, weights, 16), fast)


def test_cells_cover_equal_weight_and_none_is_empty() -> None:
    features, weights = blob(20_000)
    weights = weights + 0.5
    labels = cells.split_cells(features, weights, 256)
    counts, mass = np.bincount(labels), np.bincount(labels, weights)
    assert len(counts) == 256
    assert counts.min() >= 1
    assert mass.max() / mass.min() < 1.6


def test_more_cells_than_gaussians_asked_for() -> None:
    features, weights = blob(10)
    labels = cells.split_cells(features, weights, 1024)
    assert 4 <= labels.max() + 1 <= 8  # a power of two, at most N, less where one Gaussian outweighs the rest
    assert np.bincount(labels).min() >= 1


def test_identical_gaussians_are_dealt_out_evenly() -> None:
    labels = cells.split_cells(np.zeros((300, 6), np.float32), np.zeros(300), 64)
    sizes = np.bincount(labels, minlength=64)
    assert len(sizes) == 64
    assert (sizes.min(), sizes.max()) == (4, 5)
    assert (np.diff(labels) >= 0).all(), "ties keep the file's order"


def test_color_parts_what_lies_in_one_place() -> None:
    """A red and a blue sheet, one behind the other: no cell holds both."""
    rng = np.random.default_rng(3)
    n = 2000
    red = np.arange(n) % 2 == 0
    sh = np.where(red[:, None, None], [2.0, -2.0, -2.0], [-2.0, -2.0, 2.0])
    model = GaussianModel(
        np.concatenate([rng.uniform(-0.1, 0.1, (n, 2)), np.zeros((n, 1))], axis=1),
        np.full((n, 3), -4.0),
        np.tile([1.0, 0, 0, 0], (n, 1)),
        np.zeros(n),
        sh,
    )
    labels = cells.split_cells(cells.cell_features(model, 1.0), np.ones(n), 16)
    shares = np.bincount(labels, red) / np.bincount(labels)
    assert set(shares) == {0.0, 1.0}
