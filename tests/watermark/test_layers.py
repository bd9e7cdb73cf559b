"""Three questions to one evidence: each is the claim's own statistic on its chips."""

from __future__ import annotations

import numpy as np
import pytest

from engine.watermark.keys import OwnerKey
from engine.watermark.layers import layered_z, only
from engine.watermark.model_evidence import Evidence
from engine.watermark.spreading import spread
from engine.watermark.statistics import claim_z

TINT, ALL = 900, 1_200


def evidence(seed: int = 0) -> Evidence:
    rng = np.random.default_rng(seed)
    y, w = rng.standard_normal(ALL), rng.uniform(0.1, 3.0, ALL)
    return Evidence(y, w, np.full(ALL, 0.3), (np.zeros((4, 3), np.float32),))


def test_each_copy_gets_the_statistic_of_a_claim() -> None:
    read, key = evidence(), OwnerKey(bytes(range(32)))
    messages = np.random.default_rng(1).choice([-1, 1], (300, 16)).astype(np.int8)
    for k, message in enumerate(messages):
        copy = spread(key, k.to_bytes(2, "big"), (400,), 3, 16)
        found = layered_z(read, copy.signs(message), TINT).z
        for name, part in (("both", slice(None)), ("tint", slice(TINT)), ("grain", slice(TINT, None))):
            alone = claim_z(read.y[part], read.weights[part], copy.bit_of[part], copy.chips[part], message)
            assert found[name] == pytest.approx(alone, rel=1e-9, abs=1e-12)


def test_signs_of_another_length_are_refused() -> None:
    with pytest.raises(ValueError, match="5 signs, the evidence 1200"):
        layered_z(evidence(), np.ones(5, np.int8), TINT)


def test_nothing_measured_is_zero() -> None:
    empty = Evidence(np.zeros(ALL), np.ones(ALL), np.zeros(ALL))
    assert set(layered_z(empty, np.ones(ALL, np.int8), TINT).z.values()) == {0.0}


def test_one_layer_is_not_drowned_by_another_copy_s() -> None:
    rng = np.random.default_rng(2)
    mine, other = (rng.choice([-1, 1], ALL).astype(np.int8) for _ in range(2))
    y = np.where(np.arange(ALL) < TINT, 0.1 * mine, 5.0 * other)
    found = layered_z(Evidence(y, np.ones(ALL), np.ones(ALL)), mine, TINT)
    assert found.strongest == "tint"
    assert found.best == pytest.approx(30.0)
    assert abs(found.z["both"]) < 5


def test_a_mark_turned_round_is_loud_only_where_both_ways_are_asked() -> None:
    mine = np.random.default_rng(3).choice([-1, 1], ALL).astype(np.int8)
    y = -1.0 * mine
    y[TINT:] = 0.0
    turned = Evidence(y, np.ones(ALL), np.ones(ALL))
    assert layered_z(turned, mine, TINT, either_way=True).best == pytest.approx(-30.0)
    assert layered_z(turned, mine, TINT).best == 0.0


def test_pictures_have_one_layer() -> None:
    read = evidence()
    tint = Evidence(read.y[:TINT], read.weights[:TINT], read.signal[:TINT])
    assert set(layered_z(tint, np.ones(TINT, np.int8), TINT).z) == {"both", "tint"}


def test_only_one_layer_weighs() -> None:
    read = evidence()
    assert only(read, "both", TINT) is read
    for layer, gone in (("tint", slice(TINT, None)), ("grain", slice(TINT))):
        part = only(read, layer, TINT)
        assert not part.weights[gone].any()
        assert not part.signal[gone].any()
        assert part.pulled is read.pulled
        kept = np.setdiff1d(np.arange(ALL), np.arange(ALL)[gone])
        np.testing.assert_array_equal(part.weights[kept], read.weights[kept])
        np.testing.assert_array_equal(part.signal[kept], read.signal[kept])
