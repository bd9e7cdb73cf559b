"""Values, edges and scales of the claim statistics; the theorems behind them are tested in tests/theory."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from engine.lab.evaluate.null.null_rates import wrong_key_z
from engine.watermark.keys import OwnerKey, signs
from engine.watermark.power import expected_z, moments
from engine.watermark.statistics import (
    DISHONEST_CLAIMANT_RATE,
    bit_sums,
    claim_z,
    decode_bits,
    log10_binomial_tail,
    log10_false_claim_bound,
    weighted_evidence,
    z_threshold,
)

SEED = bytes(range(32))


def evidence(chips: int = 4096, bits: int = 16, amplitude: float = 0.5):
    rng = np.random.default_rng(5)
    bit_of = rng.permutation(np.arange(chips) % bits)
    chip = signs(SEED, chips)
    message = signs(SEED[::-1], bits)
    w = rng.uniform(0.5, 2, chips)
    y = rng.normal(size=chips) + amplitude * chip * message[bit_of]
    return y, w, bit_of, chip, message


def test_claim_z_against_the_formula() -> None:
    y, w, bit_of, chip, message = evidence()
    plain = sum(a * b * c * message[k] for a, b, c, k in zip(y, w, chip, bit_of, strict=True))
    plain /= math.sqrt(sum((a * b) ** 2 for a, b in zip(y, w, strict=True)))
    assert claim_z(y, w, bit_of, chip, message) == pytest.approx(plain, rel=1e-12)
    T, norm = bit_sums(weighted_evidence(y, w), bit_of, chip, len(message))
    assert (T @ message) / np.sqrt((norm**2).sum()) == pytest.approx(plain, rel=1e-12)


def test_bits_are_read() -> None:
    y, w, bit_of, chip, message = evidence()
    bits, reliability = decode_bits(*bit_sums(weighted_evidence(y, w), bit_of, chip, len(message)))
    assert np.array_equal(bits, message)
    assert reliability.min() > 0.9
    flipped = message.copy()
    flipped[3] *= -1
    assert claim_z(y, w, bit_of, chip, flipped) < claim_z(y, w, bit_of, chip, message)


@pytest.mark.parametrize("scale", [1e-200, 1e-30, 1e30, 1e200])
def test_scale_of_evidence_does_not_matter(scale: float) -> None:
    y, w, bit_of, chip, message = evidence()
    z = claim_z(y, w, bit_of, chip, message)
    assert claim_z(y * scale, w * scale, bit_of, chip, message) == pytest.approx(z, rel=1e-9)
    assert expected_z(y * scale, w / scale, 0.5 * scale) == pytest.approx(expected_z(y, w, 0.5), rel=1e-9)


def test_no_evidence_is_no_claim() -> None:
    zero = np.zeros(32)
    bit_of, chip, message = np.arange(32) % 16, np.ones(32, np.int8), np.ones(16, np.int8)
    assert claim_z(zero, zero, bit_of, chip, message) == 0
    bits, reliability = decode_bits(*bit_sums(weighted_evidence(zero, zero), bit_of, chip, 16))
    assert (bits == 0).all()
    assert (reliability == 0.5).all()
    assert (wrong_key_z(zero, zero, SEED, 5) == 0).all()
    assert expected_z(zero, zero, zero) == 0
    assert moments(zero, zero, zero).power(6.0) == 0
    assert moments(zero, zero, zero).evidence_needed(6.0, 0.999) == math.inf


@pytest.mark.parametrize(
    ("y", "w", "message"),
    [
        ([1.0, np.nan], [1, 1], "finite"),
        ([1.0, 2.0], [1, np.inf], "finite"),
        ([1.0, 2.0], [1, -1], ">= 0"),
        ([1.0, 2.0], [1, 1, 1], "equally long"),
    ],
)
def test_bad_evidence_is_refused(y: list[float], w: list[float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        claim_z(np.array(y), np.array(w), np.zeros(2, int), np.ones(2, np.int8), np.ones(1, np.int8))


def test_bound_and_threshold_agree_and_never_underflow() -> None:
    assert log10_false_claim_bound(1e4) == pytest.approx(-5e7 / math.log(10))
    assert log10_false_claim_bound(-50.0) == 0
    assert log10_false_claim_bound(1.0, tries=1000) == 0
    for rate, tries in itertools.product((1e-3, 1e-9, DISHONEST_CLAIMANT_RATE, 1e-300), (1, 7, 10**6)):
        z = z_threshold(rate, tries)
        assert log10_false_claim_bound(z, tries) == pytest.approx(math.log10(rate), rel=1e-12)
    for bad in (0.0, -1.0, 1.5):
        with pytest.raises(ValueError, match="rate"):
            z_threshold(bad)
    with pytest.raises(ValueError, match="tried"):
        log10_false_claim_bound(1.0, 0)


def test_binomial_tail_is_exact() -> None:
    assert log10_binomial_tail(32, 32) == pytest.approx(-32 * math.log10(2))
    assert log10_binomial_tail(0, 32) == 0
    ways = sum(sum(bits) >= 9 for bits in itertools.product((0, 1), repeat=12))
    assert log10_binomial_tail(9, 12) == pytest.approx(math.log10(ways / 2**12))
    assert log10_binomial_tail(4096, 4096) == pytest.approx(-4096 * math.log10(2))
    with pytest.raises(ValueError, match="cannot match"):
        log10_binomial_tail(33, 32)


def test_reliability_grows_with_evidence_and_survives_lost_bits() -> None:
    z = np.array([0.5, 1.0, 2.0, 8.0, -8.0, 8.0, 8.0, 0.0])
    bits, reliability = decode_bits(z, np.ones(8))
    assert bits.tolist() == [1, 1, 1, 1, -1, 1, 1, 0]
    assert (np.diff(reliability[:4]) >= 0).all()
    assert reliability[0] < 0.6  # its signal was lost where the others kept theirs: no certainty
    assert reliability[3] > 1 - 1e-6
    assert reliability[7] == 0.5
    assert np.isfinite(decode_bits(1e4 * z, np.ones(8))[1]).all()
    unmarked = decode_bits(np.array([0.3, -0.8, 1.1, -0.2]), np.ones(4))[1]
    assert np.allclose(unmarked, 0.5)


def test_wrong_keys_are_the_keys_an_attacker_would_try() -> None:
    """The fast sampler against real owner keys and the plain statistic: one distribution."""
    rng = np.random.default_rng(3)
    y, w = rng.standard_cauchy(100), rng.uniform(size=100)
    message, bit_of = np.ones(1, np.int8), np.zeros(100, int)
    owners = [OwnerKey(bytes([k % 256, k // 256]) + bytes(range(30))) for k in range(1500)]
    slow = np.array([claim_z(y, w, bit_of, signs(o.derive("chips", b""), 100), message) for o in owners])
    fast = wrong_key_z(y, w, SEED, 40_000)
    points = np.linspace(-3, 3, 25)
    distance = np.abs((slow[:, None] <= points).mean(axis=0) - (fast[:, None] <= points).mean(axis=0)).max()
    assert distance < 1.95 * math.sqrt(1 / 1500 + 1 / 40_000)  # Kolmogorov-Smirnov at 0.1 %
    assert np.array_equal(wrong_key_z(y, w, SEED, 1000), wrong_key_z(y, w, SEED, 1000))
    assert not np.array_equal(wrong_key_z(y, w, SEED, 1000), wrong_key_z(y, w, SEED[::-1], 1000))


def test_wrong_keys_match_enumeration() -> None:
    y = np.array([1.0, 2.0, -0.5, 0.25, 3.0])
    every = {round(float(np.dot(s, y) / np.linalg.norm(y)), 12) for s in itertools.product((-1, 1), repeat=5)}
    assert {round(float(z), 12) for z in wrong_key_z(y, np.ones(5), SEED, 2000)} == every


def test_power_limits() -> None:
    y, w, *_ = evidence(amplitude=0.0)
    threshold = z_threshold(1e-9)
    assert moments(y, w, 1.0).power(threshold) > 0.999999
    assert moments(y, w, 0.05).power(threshold) == 0
    assert moments(np.zeros(100), np.ones(100), 1.0).power(threshold) == 1.0  # no noise at all: Z = sqrt(100)
    assert moments(np.zeros(10), np.ones(10), 1.0).power(threshold) == 0.0  # sqrt(10) never reaches 6.4
    assert moments(y, w, -1.0).power(threshold) == 0
    assert moments(y, w, -1.0).evidence_needed(threshold, 0.999) == math.inf
    with pytest.raises(ValueError, match="finite"):
        moments(y, w, np.nan).power(threshold)


def test_needed_evidence_is_enough() -> None:
    """So many copies of the evidence, each with chips of its own, reach the power; a bit fewer do not."""
    y, w, *_ = evidence(chips=512, amplitude=0.0)
    threshold = z_threshold(1e-9)
    times = moments(y, w, 0.15).evidence_needed(threshold, 0.999)
    assert times > 2
    enough, short = math.ceil(times), math.floor(0.9 * times)
    assert moments(np.tile(y, enough), np.tile(w, enough), 0.15).power(threshold) >= 0.999
    assert moments(np.tile(y, short), np.tile(w, short), 0.15).power(threshold) < 0.999


def test_a_bit_that_was_not_seen_does_not_speak_for_the_others() -> None:
    """However strong it was expected to be: reliabilities are those of the bits that were seen, by themselves."""
    z = np.array([2.0, -1.5, 3.0, 2.5])
    alone = decode_bits(z, np.ones(4))[1]
    T, norm = np.concatenate([z, np.zeros(4)]), np.repeat([1.0, 0.0], 4)
    bits, reliability = decode_bits(T, norm, strength=np.ones(8))
    np.testing.assert_allclose(reliability[:4], alone)
    assert (reliability[4:] == 0.5).all()
    assert bits.tolist() == [1, -1, 1, 1, 0, 0, 0, 0]
