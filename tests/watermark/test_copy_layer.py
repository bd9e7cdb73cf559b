"""The copy layer: bell-curve values that follow from one copy's key, read beside the owner's layer."""

from __future__ import annotations

import numpy as np
import pytest

from engine.watermark.copy_layer import CopyLayer, grain_without_owner, without_owner
from engine.watermark.grain import Grain
from engine.watermark.keys import OwnerKey
from engine.watermark.layout import Layout
from engine.watermark.model_evidence import Evidence, Residual
from engine.watermark.spreading import ONE_BIT, spread, spread_copy, spread_grain

KEY = OwnerKey(bytes(range(32)))


def subkey(name: bytes) -> bytes:
    return KEY.derive("copy", name)


def layer(gaussians: int = 500, codes: int = 20) -> CopyLayer:
    labels = (np.arange(gaussians) % codes).astype(np.int32)
    return CopyLayer(Layout((labels,), (codes,), (np.eye(3),), np.full(3 * codes, 0.01)), Grain(0.02, 0.01))


def test_values_are_those_of_a_bell_curve_and_another_copy_has_others() -> None:
    one, two = (spread_copy(subkey(name), 200_000, "tint").values(ONE_BIT) for name in (b"a", b"b"))
    assert one.mean() == pytest.approx(0.0, abs=0.01)
    assert np.mean(one**2) == pytest.approx(1.0, abs=0.01)
    assert np.mean(one**4) == pytest.approx(2.8, abs=0.05)  # a normal's is 3
    assert np.abs(one).max() < 4.25
    assert np.abs(np.corrcoef(one, two)[0, 1]) < 0.01
    assert len(np.unique(one)) > 100_000


def test_a_sign_is_fair_whatever_the_size() -> None:
    """What the theorem needs of evidence that is weighted by sizes."""
    for spreading in (
        spread_copy(subkey(b"a"), 200_000, "grain"),
        spread_grain(subkey(b"c"), 40_000, 16, sized=True),
        spread(KEY, b"x" * 48, (50_000,), 3, 16, sized=True),
    ):
        assert spreading.sizes is not None
        assert np.mean(spreading.sizes.astype(np.float64) ** 2) == pytest.approx(1.0, abs=0.01)
        order = np.argsort(spreading.sizes)
        for part in np.array_split(spreading.chips[order], 4):
            assert abs(part.mean()) < 5 / np.sqrt(len(part))


def test_layers_have_streams_of_their_own() -> None:
    tint, grain = (spread_copy(subkey(b"a"), 50_000, use).values(ONE_BIT) for use in ("tint", "grain"))
    assert abs(np.corrcoef(tint, grain)[0, 1]) < 0.02


def test_chips_of_a_part_are_those_of_its_gaussians() -> None:
    whole = layer()
    kept = np.zeros(500, dtype=bool)
    kept[100:300] = True
    all_of_it = whole.spreading(subkey(b"a"), None, 500).values(ONE_BIT)
    part = whole.at(np.flatnonzero(kept)).spreading(subkey(b"a"), kept, 500).values(ONE_BIT)
    np.testing.assert_array_equal(part, np.concatenate([all_of_it[:60], all_of_it[60 + 600 : 60 + 1800]]))


@pytest.mark.parametrize("left", [0.0, 0.4, 1.0])
def test_as_much_of_the_owners_layer_is_taken_off_as_there_is(left: float) -> None:
    rng = np.random.default_rng(3)
    owner, noise = rng.normal(0, 0.02, (4_000, 3)), rng.normal(0, 0.02, (4_000, 3))
    rows = np.arange(4_000)
    found = Residual(left * owner + noise, np.ones(4_000), rows, rows.astype(np.int32), np.ones(4_000))
    rest = without_owner(found, owner).values
    assert np.abs(rest - noise).max() < 0.05 * np.abs(owner).max()
    y, moves = (left * owner + noise).reshape(-1), owner.reshape(-1)
    said = grain_without_owner(Evidence(y, np.ones(len(y)), np.ones(len(y))), moves)
    assert abs(np.corrcoef(said.y, moves)[0, 1]) < 0.05


def test_mixtures_lose_their_parts_shares_of_it() -> None:
    owner = np.array([[1.0, 0, 0], [0, 2.0, 0], [0, 0, 0]])
    merged = Residual(
        np.array([[0.25, 1.5, 0.0], [0.0, 0.0, 0.0]]),
        np.ones(2),
        np.array([0, 0, 1]),
        np.array([0, 1, 2], np.int32),
        np.array([0.25, 0.75, 1.0]),
    )
    np.testing.assert_allclose(without_owner(merged, owner).values, 0.0, atol=1e-12)
