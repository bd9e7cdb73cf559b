"""The bound on false claims: against adversarial evidence and foreign marks, and how it would be lost."""

from __future__ import annotations

import numpy as np
import pytest

from engine.lab.evaluate.null.null_rates import wrong_key_z
from engine.watermark.keys import signs
from engine.watermark.model_evidence import Evidence
from engine.watermark.statistics import claim_z, log10_binomial_tail, z_threshold

KEYS = 200_000
SEED = bytes(range(32))
RNG = np.random.default_rng(11)
CHIPS = 2000


def _real_looking() -> np.ndarray:
    """Displacements as a converted, locally edited model shows them: sparse, correlated, rounded, skewed."""
    smooth = np.convolve(RNG.normal(size=CHIPS + 50), np.ones(51) / 51, "valid")
    return np.round(np.exp(smooth * 4) * (RNG.uniform(size=CHIPS) < 0.3), 1) + 0.01


EVIDENCE = {
    "gaussian": RNG.normal(size=CHIPS),
    "cauchy": RNG.standard_cauchy(CHIPS),
    "one dominant chip": np.where(np.arange(CHIPS) == 7, 1e6, 1.0),
    "few chips": np.where(np.arange(CHIPS) < 3, 1.0, 0.0),
    "constant": np.ones(CHIPS),
    "geometric": 0.9 ** np.arange(CHIPS),
    "foreign mark": 5.0 * signs(SEED[::-1], CHIPS) + RNG.normal(size=CHIPS),
    "real-looking": _real_looking(),
}


@pytest.mark.parametrize("kind", EVIDENCE)
def test_measured_rate_stays_below_the_bound(kind: str) -> None:
    """Over 200,000 wrong keys, at every threshold from 1e-1 to 1e-5."""
    weights = np.random.default_rng(13).uniform(0.1, 3, CHIPS)
    z = wrong_key_z(EVIDENCE[kind], weights, SEED, KEYS)
    for exponent in np.arange(1, 5.01, 0.25):
        bound = 10.0**-exponent
        hits = int((z >= z_threshold(bound)).sum())
        chance = 5 * np.sqrt(bound * KEYS) if bound * KEYS < 100 else 0.0  # a handful of hits may be luck
        assert hits <= bound * KEYS + chance, (kind, exponent)
    assert abs(z.mean()) < 5 / np.sqrt(KEYS)
    assert z.std() == pytest.approx(1, abs=0.02)
    assert z.max() < z_threshold(1e-9, tries=KEYS)  # the best of all wrong keys claims nothing


def test_the_bound_is_attained_nowhere_but_not_empty() -> None:
    """One chip: P(Z >= 1) is one half, the bound exp(-1/2) = 0.61. No factor below 0.82 could sharpen it."""
    z = wrong_key_z(np.array([3.0]), np.array([1.0]), SEED, 10_000)
    rate = (z >= 1).mean()
    assert rate == pytest.approx(0.5, abs=0.03)
    assert rate <= np.exp(-0.5)


def test_matching_bits_of_wrong_keys_are_fair_coins() -> None:
    """Published systems read 58 to 65 % matching bits from unmarked models; here it is half, and binomial."""
    bits, per_bit, keys = 32, 8, 20_000
    y = EVIDENCE["real-looking"][: bits * per_bit]
    chips = signs(SEED, keys * len(y)).reshape(keys, bits, per_bit)
    T = (chips * y.reshape(bits, per_bit)).sum(axis=2)
    matches = (T > 0).sum(axis=1)  # against the message of all ones; T = 0 is no match
    assert matches.mean() / bits == pytest.approx(0.5, abs=0.01)
    for least in (20, 22, 24, 26):
        tail = 10 ** log10_binomial_tail(least, bits)
        assert (matches >= least).mean() <= tail + 5 * np.sqrt(tail / keys)


def test_shortcut_mistake_lets_every_wrong_key_find_itself() -> None:
    """Reference rebuilt as "suspect minus the mark of the key under test": what the theorem needs is gone.

    The honest path stores the unmarked reference, and the same keys find nothing in the same suspect.
    """
    bits, amplitude = 16, 1.0
    bit_of, message = np.arange(CHIPS) % bits, signs(SEED, bits)
    reference = RNG.normal(size=CHIPS)
    suspect = reference + RNG.normal(size=CHIPS)  # unmarked, edited
    honest, shortcut = [], []
    for k in range(200):
        chips = signs(bytes([k]) + SEED[1:], CHIPS)
        mark = amplitude * chips * message[bit_of]
        weights = np.ones(CHIPS)
        honest.append(claim_z(suspect - reference, weights, bit_of, chips, message))
        rebuilt = suspect - mark  # never do this
        shortcut.append(claim_z(suspect - rebuilt, weights, bit_of, chips, message))
    assert max(honest) < z_threshold(1e-9)
    assert min(shortcut) > 40  # every wrong key "proves" its claim, at 1e-347


def test_listing_a_chip_twice_loses_the_bound_and_summing_keeps_it() -> None:
    """Two pictures of one asset say something about the same chips."""
    first = EVIDENCE["gaussian"]
    second = first + 0.1 * RNG.normal(size=CHIPS)
    twice, weights = np.concatenate([first, second]), np.ones(CHIPS)
    bit_of, message, keys = np.zeros(2 * CHIPS, int), np.ones(1, np.int8), 4000
    appended, summed = np.empty(keys), np.empty(keys)
    both = Evidence(first, weights, weights).plus(Evidence(second, weights, weights))
    chips = signs(SEED, keys * CHIPS).reshape(keys, CHIPS)
    for k in range(keys):
        appended[k] = claim_z(twice, np.ones(2 * CHIPS), bit_of, np.tile(chips[k], 2), message)
        summed[k] = claim_z(both.y, both.weights, bit_of[:CHIPS], chips[k], message)
    assert appended.std() == pytest.approx(np.sqrt(2), rel=0.05)  # its null is too wide ...
    assert (appended >= z_threshold(0.01)).mean() > 0.015  # ... and the bound is broken
    assert summed.std() == pytest.approx(1, rel=0.05)
    assert (summed >= z_threshold(0.01)).mean() <= 0.01
