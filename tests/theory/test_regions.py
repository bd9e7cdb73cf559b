"""False discoveries among regions, counted where the truth is known; and what it costs to draw regions by signs."""

from __future__ import annotations

import numpy as np
import pytest

from engine.watermark.grain import ATTRIBUTES
from engine.watermark.model_evidence import Evidence
from engine.watermark.regions import Partition, RegionConfig, Regions, State, judge_regions

REGIONS, CODES, GAUSSIANS, CARRIERS = 32, 512, 1024, 3
TINT = CODES * CARRIERS
CHIPS = TINT + ATTRIBUTES * GAUSSIANS
Q = 0.1
LEAVES = Partition(
    REGIONS,
    TINT,
    (np.arange(CODES) * REGIONS // CODES).astype(np.int32),
    (np.arange(GAUSSIANS) * REGIONS // GAUSSIANS).astype(np.int32),
)
MARKED = np.arange(REGIONS) % 2 == 0  # every other region carries the mark


def region_of_chips() -> np.ndarray:
    return np.concatenate([np.repeat(LEAVES.of_codes, CARRIERS), np.repeat(LEAVES.of_gaussians, ATTRIBUTES)])


def suspect(rng: np.random.Generator, signs: np.ndarray, noise: float, foreign: bool, marked: np.ndarray) -> Evidence:
    """Regions with the mark, the others with noise or with another owner's mark, all of it under noise."""
    there = marked[region_of_chips()]
    other = rng.integers(0, 2, CHIPS) * 2.0 - 1.0 if foreign else np.zeros(CHIPS)
    y = np.where(there, signs, other) + noise * rng.standard_t(3, CHIPS)
    return Evidence(y, 1.0 / (1.0 + np.square(y)), np.full(CHIPS, 1.0))  # weights may know how large y is


def judged(evidence: Evidence, signs: np.ndarray, leaves: Partition = LEAVES) -> Regions:
    return judge_regions([evidence], signs, leaves, TINT, tries=3, config=RegionConfig(false_discoveries=Q))


def draw(rng: np.random.Generator) -> np.ndarray:
    return (rng.integers(0, 2, CHIPS) * 2 - 1).astype(np.int8)


@pytest.mark.parametrize(("noise", "foreign"), [(1.0, False), (2.0, True)])
def test_false_discoveries_stay_below_the_level(noise: float, foreign: bool) -> None:
    rng = np.random.default_rng(1)
    shares, missed = [], []
    for _ in range(120):
        signs = draw(rng)
        found = judged(suspect(rng, signs, noise, foreign, MARKED), signs)
        assert found.partition.count == REGIONS, "no region was joined: the truth of each is known"
        called = found.state == State.MARKED
        shares.append((called & ~MARKED).sum() / max(1, called.sum()))
        missed.append((MARKED & ~called).sum() / MARKED.sum())
    assert np.mean(shares) < Q
    assert np.mean(missed) < 0.2


def test_a_wrong_key_discovers_nothing() -> None:
    rng = np.random.default_rng(2)
    evidence = suspect(rng, draw(rng), 1.0, False, MARKED)
    any_at_all = [bool((judged(evidence, draw(rng)).state == State.MARKED).any()) for _ in range(200)]
    assert np.mean(any_at_all) < Q
    assert (judged(evidence, draw(rng)).log10_p > -4).all()


def test_regions_drawn_by_their_signs_discover_anything() -> None:
    """The mistake: chips that agree put into one region. Its level says nothing any more."""
    rng = np.random.default_rng(3)
    signs = draw(rng)
    evidence = suspect(rng, signs, 1.0, False, np.zeros(REGIONS, dtype=bool))
    agree = (evidence.evidence * signs)[:TINT].reshape(CODES, CARRIERS).sum(axis=1) > 0
    by_signs = Partition(2, TINT, agree.astype(np.int32), LEAVES.of_gaussians % 2)
    assert not (judged(evidence, signs).state == State.MARKED).any()
    assert (judged(evidence, signs, by_signs).state == State.MARKED).any()
