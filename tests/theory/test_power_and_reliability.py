"""The alternative: the power to see a mark, and how often a bit is wrong, against simulation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from engine.watermark.keys import signs
from engine.watermark.power import expected_z, moments
from engine.watermark.statistics import bit_sums, claim_z, decode_bits, weighted_evidence, z_threshold

SEED = bytes(range(32))


def simulate_z(y: np.ndarray, w: np.ndarray, signal: np.ndarray, keys: int) -> np.ndarray:
    """Z of `keys` marks, each with chips of its own, all laid over the same noise."""
    chips = signs(SEED, keys * len(y)).reshape(keys, len(y))
    c = w * (y + signal * chips)
    return (c * chips).sum(axis=1) / np.sqrt((c * c).sum(axis=1))


@pytest.mark.parametrize("noise", ["gaussian", "heavy", "few"])
@pytest.mark.parametrize("shift", [-1.5, 0.0, 1.0, 2.5])
def test_power_against_simulation(noise: str, shift: float) -> None:
    rng = np.random.default_rng(6)
    n = 12 if noise == "few" else 1500
    y = rng.standard_t(2.5, size=n) if noise == "heavy" else rng.normal(size=n)
    w, signal = rng.uniform(0.2, 2, n), rng.uniform(0.05, 0.4, n) * (8 if noise == "few" else 1)
    threshold = expected_z(y, w, signal) - shift
    measured = float((simulate_z(y, w, signal, 6000) >= threshold).mean())
    proven, normal = moments(y, w, signal).power(threshold), moments(y, w, signal).power(threshold, proven=False)
    slack = 4 * math.sqrt(0.25 / 6000)
    assert proven <= measured + slack  # a bound, whatever the noise
    if noise != "few":
        assert normal == pytest.approx(measured, abs=0.05)


def test_power_is_the_bound_of_its_text() -> None:
    """1 - exp(-x^2 / 2), x = (S - t sqrt(Q)) / |a|, a = w y (1 - t w s / sqrt(Q)), term by term."""
    rng = np.random.default_rng(11)
    y, w, signal = rng.normal(size=40), rng.uniform(0.2, 2, 40), rng.uniform(0.5, 2.0, 40)
    threshold = 2.0
    S = sum(wi * si for wi, si in zip(w, signal, strict=True))
    Q = sum(wi**2 * (yi**2 + si**2) for yi, wi, si in zip(y, w, signal, strict=True))
    a = [wi * yi * (1 - threshold * wi * si / math.sqrt(Q)) for yi, wi, si in zip(y, w, signal, strict=True)]
    x = (S - threshold * math.sqrt(Q)) / math.sqrt(sum(ai**2 for ai in a))
    assert 0.5 < x < 5
    assert moments(y, w, signal).power(threshold) == pytest.approx(1 - math.exp(-(x**2) / 2), rel=1e-9)
    assert expected_z(y, w, signal) == pytest.approx(S / math.sqrt(Q), rel=1e-9)


def test_expected_z_against_simulation() -> None:
    rng = np.random.default_rng(7)
    y, w, signal = rng.normal(size=1500), rng.uniform(size=1500), rng.uniform(0, 0.5, 1500)
    assert simulate_z(y, w, signal, 2000).mean() == pytest.approx(expected_z(y, w, signal), rel=0.01)


def test_proven_power_is_not_empty() -> None:
    """What "not marked" needs is within reach: three deviations above the threshold the bound says 98.9 %."""
    y, w = np.random.default_rng(8).normal(size=4000), np.ones(4000)
    threshold = z_threshold(1e-9)
    signal = next(s for s in np.arange(0.01, 1, 0.002) if moments(y, w, s).power(threshold) >= 0.999)
    assert expected_z(y, w, signal) < threshold + 4.2
    simulated = simulate_z(y, w, np.full(4000, signal), 2000)
    assert (simulated >= threshold).mean() >= 0.999


def test_a_mark_of_mixed_signs_counts_what_it_nets() -> None:
    """Cross-talk can push a chip's y against its own sign; power follows the net response."""
    rng = np.random.default_rng(9)
    y, w = rng.normal(size=1500), np.ones(1500)
    signal = 0.2 + 0.3 * rng.normal(size=1500)
    threshold = expected_z(y, w, signal) - 1
    measured = float((simulate_z(y, w, signal, 4000) >= threshold).mean())
    assert moments(y, w, signal).power(threshold, proven=False) == pytest.approx(measured, abs=0.05)


@pytest.mark.parametrize("amplitude", [0.0, 0.06, 0.1, 0.15, 0.25])
def test_reliability_is_calibrated(amplitude: float) -> None:
    """Of the bits called 80 % reliable, about 80 % are right: never clearly fewer."""
    bits, chips_n, runs = 32, 3200, 300
    rng = np.random.default_rng(10)
    bit_of = np.arange(chips_n) % bits
    right, stated = [], []
    for _ in range(runs):
        chips = (2 * rng.integers(0, 2, chips_n) - 1).astype(np.int8)
        message = (2 * rng.integers(0, 2, bits) - 1).astype(np.int8)
        y = rng.normal(size=chips_n) + amplitude * chips * message[bit_of]
        decoded, reliability = decode_bits(*bit_sums(weighted_evidence(y, np.ones(chips_n)), bit_of, chips, bits))
        right.append(decoded == message)
        stated.append(reliability)
    right_all, stated_all = np.concatenate(right), np.concatenate(stated)
    for low, high in ((0.5, 0.6), (0.6, 0.7), (0.7, 0.8), (0.8, 0.9), (0.9, 0.97), (0.97, 1.01)):
        group = (stated_all >= low) & (stated_all < high)
        count = int(group.sum())
        if count < 200 or amplitude == 0:
            continue
        measured, claimed = right_all[group].mean(), stated_all[group].mean()
        assert measured > claimed - 0.03 - 4 * math.sqrt(0.25 / count), (low, measured, claimed)
        assert measured < claimed + 0.12, (low, measured, claimed)
    if amplitude == 0:  # unmarked: the fit of 32 bits sees little where nothing is
        assert np.median(stated_all) < 0.6
        assert stated_all.mean() < 0.65


def test_reliability_knows_which_bits_the_picture_shows() -> None:
    """A crop holds little of some bits. With the expected strength given, their doubt is stated."""
    bits, runs = 16, 400
    rng = np.random.default_rng(12)
    counts = np.where(np.arange(bits) < 8, 400, 8)
    bit_of = np.repeat(np.arange(bits), counts)
    right, stated = np.zeros(bits), np.zeros(bits)
    for _ in range(runs):
        chips = (2 * rng.integers(0, 2, len(bit_of)) - 1).astype(np.int8)
        y = rng.normal(size=len(bit_of)) + 0.2 * chips
        decoded, reliability = decode_bits(
            *bit_sums(weighted_evidence(y, np.ones_like(y)), bit_of, chips, bits), strength=np.sqrt(counts)
        )
        right += decoded == 1
        stated += reliability
    assert stated[:8].mean() / runs == pytest.approx(right[:8].mean() / runs, abs=0.02)
    assert stated[8:].mean() / runs == pytest.approx(right[8:].mean() / runs, abs=0.05)
    assert claim_z(y, np.ones_like(y), bit_of, chips, np.ones(bits, np.int8)) > 5


def test_sums_of_two_evidences_are_those_of_both_whatever_their_units() -> None:
    rng = np.random.default_rng(8)
    y, w, s = rng.normal(size=90), rng.uniform(0.5, 1.0, 90), rng.uniform(0.1, 0.3, 90)
    for scale in (1.0, 1e-120):  # so small that its squares are measured in units of their own
        first, second = moments(y[:40], w[:40], s[:40]), moments(scale * y[40:], w[40:] / scale, scale * s[40:])
        tiny = moments(1e-120 * y[40:], w[40:], 1e-120 * s[40:])
        assert tiny.unit != 1.0
        both = moments(y, w, s)
        assert first.plus(second).power(6.0) == pytest.approx(both.power(6.0), rel=1e-9)
        assert first.plus(tiny).expected_z == pytest.approx(first.expected_z, rel=1e-9)
