"""Cells of one copy: neighbours only, even, drawn by the key, and other ones for every copy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.compress.cells import cell_features
from engine.compress.hvq import HvqConfig, Stage, group_means, quantize
from engine.model import Float64, GaussianModel
from engine.watermark import secret_cells
from engine.watermark.config import CONFIG
from engine.watermark.keys import OwnerKey
from engine.watermark.secret_cells import cells_key, jitter, join_cells
from tests.watermark.test_grain import blobs

KEY = OwnerKey(bytes(range(32)))


def public(count: int = 8_000) -> tuple[GaussianModel, Stage, Float64, Float64]:
    model = blobs(count)
    weights = np.random.default_rng(1).uniform(0.5, 2.0, count)
    stage = quantize(model, weights, 3.0, HvqConfig(cells=1024))[0]
    return model, stage, group_means(cell_features(model, 3.0), stage.labels, weights).astype(np.float64), weights


def joined(use: str = "a", asset: bytes = b"x" * 32, count: int = 256, *, blurred: bool = False) -> Stage:
    model, stage, features, weights = public()
    return join_cells(stage, features, model, weights, count, cells_key(KEY, asset, use), blurred=blurred)


def same_share(one: Stage, other: Stage) -> float:
    """Share of pairs of public cells, together in one, that are together in the other, too."""
    _, stage, *_ = public()
    first = np.unique(stage.labels, return_index=True)[1]
    a, b = one.labels[first], other.labels[first]
    together = (a[:, None] == a) & ~np.eye(len(a), dtype=bool)
    return float(((b[:, None] == b) & together).sum() / together.sum())


def test_each_code_vector_is_a_few_whole_neighbouring_cells() -> None:
    model, stage, features, weights = public()
    made = join_cells(stage, features, model, weights, 256, cells_key(KEY, b"x" * 32, ""))
    assert len(made.codebook) == 256
    for cell in range(0, 1024, 37):
        assert len(np.unique(made.labels[stage.labels == cell])) == 1
    spread = np.array([features[np.unique(stage.labels[made.labels == k])].std(axis=0).sum() for k in range(256)])
    assert np.median(spread) < 0.4 * features.std(axis=0).sum()
    shares = np.bincount(made.labels, weights)
    assert shares.max() < 3.0 * np.median(shares)
    assert shares.min() > 0.3 * np.median(shares)
    five = made.labels == 5
    mean = np.average(model.sh.reshape(len(model), -1)[five], axis=0, weights=weights[five])
    np.testing.assert_allclose(made.codebook[5], mean, rtol=1e-3, atol=1e-5)


def test_blurred_cells_have_no_border_along_a_public_one() -> None:
    """Gaussians of one public cell belong to several, all of them near."""
    _, stage, features, _ = public()
    made = joined("copies", blurred=True)
    several = [len(np.unique(made.labels[stage.labels == cell])) for cell in range(0, 1024, 37)]
    assert np.mean(several) > 2.0
    spread = np.array([features[stage.labels[made.labels == k]].std(axis=0).sum() for k in range(len(made.codebook))])
    assert np.median(spread) < 0.6 * features.std(axis=0).sum()


def test_cells_of_another_use_are_others() -> None:
    assert np.array_equal(joined("a").labels, joined("a").labels)
    assert same_share(joined("a"), joined("a")) == 1.0
    assert same_share(joined("a"), joined("b")) < 0.6
    assert same_share(joined("a"), joined("a", b"y" * 32)) < 0.6


@pytest.mark.parametrize("held", ["tilt", "slide"])
def test_cuts_are_tilted_and_slid_by_the_key(held: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of the two alone makes copies differ."""
    monkeypatch.setattr(secret_cells, "_CONFIG", replace(CONFIG.cells, **{held: 0.0}))
    assert same_share(joined("a"), joined("b")) < 0.9


def test_at_most_one_for_two_cells() -> None:
    assert len(joined(count=4096).codebook) == 512


def test_amplitudes_differ_by_the_key_and_keep_their_energy() -> None:
    factors, others = (jitter(cells_key(KEY, b"x" * 32, copy), 4_096) for copy in "ab")
    assert np.mean(factors**2) == pytest.approx(1.0)
    assert 0.1 < factors.std() < 0.3
    assert abs(np.corrcoef(factors, others)[0, 1]) < 0.1
