"""The codebooks of SOG against the best there are, and its palettes against plain k-means."""

from __future__ import annotations

import numpy as np
import pytest

from engine.formats.sog.codebook import learn_codebook, nearest_codes
from engine.formats.sog.palette import learn_palette, palette_size
from tests.reference.quantization import best_codebook_error, kmeans_error


@pytest.mark.parametrize("shape", ["normal", "heavy tails", "two clusters", "grid"])
def test_codebook_is_nearly_the_best_there_is(shape):
    rng = np.random.default_rng(1)
    values = {
        "normal": rng.normal(size=1500),
        "heavy tails": rng.standard_t(3, 1500),
        "two clusters": np.concatenate([rng.normal(0, 0.01, 1400), rng.normal(9, 1, 100)]),
        "grid": np.repeat(np.arange(150) / 7, 10) + rng.normal(0, 1e-3, 1500),
    }[shape].astype(np.float32)
    book = learn_codebook(values, levels=32)
    assert (np.diff(book) >= 0).all()
    error = float(((values - book[nearest_codes(values, book)]).astype(float) ** 2).sum())
    best = best_codebook_error(values, 32)
    assert best <= error * (1 + 1e-6)
    assert error <= 1.001 * best


def test_codebook_minds_weights_and_keeps_few_values():
    values = np.array([[0.0, 0.5], [0.25, 0.5]], dtype=np.float32)
    book = learn_codebook(values)
    np.testing.assert_array_equal(np.unique(book), [0, 0.25, 0.5])
    np.testing.assert_array_equal(book[nearest_codes(values, book)], values)
    values = np.array([0, 1, 10, 11], dtype=np.float32)
    book = learn_codebook(values, np.array([9.0, 1.0, 1.0, 1.0]), levels=2)
    np.testing.assert_allclose(book, [0.1, 10.5])


def test_palette_of_two_levels_is_nearly_that_of_plain_kmeans():
    rng = np.random.default_rng(3)
    hubs = rng.normal(size=(40, 9))
    vectors = (hubs[rng.integers(0, 40, 3000)] + rng.normal(0, 0.4, (3000, 9))).astype(np.float32)
    codes, labels = learn_palette(vectors, 128)
    assert len(codes) <= 128
    error = float(((vectors - codes[labels]) ** 2).sum(axis=1).mean())
    assert error <= 1.25 * kmeans_error(vectors, 128, rounds=8, seed=0)


def test_palette_keeps_what_is_quantised_already():
    rng = np.random.default_rng(4)
    book = rng.normal(size=(50, 24)).astype(np.float32)
    vectors = book[rng.integers(0, 50, 1000)]
    codes, labels = learn_palette(vectors, 64)
    assert len(codes) <= 50
    np.testing.assert_array_equal(codes[labels], vectors)
    codes, labels = learn_palette(vectors, 49)
    assert len(codes) <= 49
    assert set(np.unique(labels)) <= set(range(len(codes)))


def test_palette_size_is_that_of_playcanvas():
    counts = (1, 1023, 1024, 2048, 65_535, 65_536, 500_000, 10_000_000)
    assert [palette_size(n) for n in counts] == [1, 512, 1024, 2048, 32_768, 65_536, 65_536, 65_536]
