"""Regions: disjoint, made of neighbours, joined where they say too little, and each in one of four states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.errors import InputError
from engine.watermark.config import CONFIG
from engine.watermark.model_evidence import Evidence
from engine.watermark.power import expected_z
from engine.watermark.regions import Partition, RegionConfig, Regions, State, discoveries, divide, judge_regions
from engine.watermark.statistics import claim_z
from tests.watermark.ball import marked_ball

BALL = marked_ball(count=3000, stages=2)
LAYOUT = BALL.plan.layout
LEAVES = divide(LAYOUT, BALL.model.means, 256)
SIGNS = BALL.spreading.signs(BALL.message)
FIRST = LAYOUT.codes[0] * len(LAYOUT.directions[0])
ALL = np.ones(len(BALL.model), dtype=bool)


def test_leaves_are_disjoint_and_balanced_and_neighbours() -> None:
    assert LEAVES.count >= 4
    assert LEAVES.count & (LEAVES.count - 1) == 0
    codes = np.bincount(LEAVES.of_codes[LEAVES.of_codes >= 0], minlength=LEAVES.count)
    assert codes.min() >= CONFIG.regions.codes
    assert codes.max() - codes.min() <= 1
    np.testing.assert_array_equal(LEAVES.of_gaussians, LEAVES.of_codes[LAYOUT.labels[0]])
    means = BALL.model.means
    spread = [means[LEAVES.of_gaussians == k].std(axis=0).mean() for k in range(LEAVES.count)]
    assert np.mean(spread) < 0.8 * means.std(axis=0).mean()


def test_gaussians_whose_code_carries_nothing_go_with_their_neighbours() -> None:
    amplitudes = LAYOUT.amplitudes.copy()
    amplitudes[:3] = 0.0
    leaves = divide(replace(LAYOUT, amplitudes=amplitudes), BALL.model.means, 256)
    assert leaves.of_codes[0] == -1
    assert (leaves.of_gaussians >= 0).all()


def test_every_chip_of_the_first_stage_counts_once_and_no_other() -> None:
    """Code vectors of further stages are all over the asset: they lie in no region."""
    np.testing.assert_allclose(LEAVES.sums(np.ones(LAYOUT.chips), LAYOUT.chips).sum(axis=0), [FIRST, 0])
    grain = np.concatenate([np.zeros(LAYOUT.chips), np.ones(6 * len(BALL.model))])
    np.testing.assert_allclose(LEAVES.sums(grain, LAYOUT.chips).sum(axis=0), [0, 6 * len(BALL.model)])


def evidence(noise: float = 0.3, marked: bool = True, weights: float | np.ndarray = 1.0) -> Evidence:
    random = np.random.default_rng(5).normal(size=LAYOUT.chips)
    y = (LAYOUT.amplitudes * SIGNS if marked else 0.0) + noise * LAYOUT.amplitudes * random
    return Evidence(y, np.broadcast_to(weights, y.shape).copy(), LAYOUT.amplitudes.copy())


def judged(said: Evidence, **given: object) -> Regions:
    return judge_regions([said], SIGNS, LEAVES, LAYOUT.chips, **{"tries": 3, "found": ALL, **given})  # type: ignore[arg-type]


def test_z_of_a_region_is_that_of_its_chips_alone() -> None:
    said, found = evidence(), judged(evidence())
    inside = np.repeat(found.partition.of_codes == 2, len(LAYOUT.directions[0]))
    inside = np.concatenate([inside, np.zeros(LAYOUT.chips - FIRST, dtype=bool)])
    bits = np.zeros(inside.sum(), dtype=np.int32)
    one = np.ones(1, dtype=np.int8)
    assert found.z[2] == pytest.approx(claim_z(said.y[inside], said.weights[inside], bits, SIGNS[inside], one))
    assert found.expected[2] == pytest.approx(expected_z(said.y[inside], said.weights[inside], said.signal[inside]))
    assert found.log10_p[2] == pytest.approx(np.log10(3) - found.z[2] ** 2 / 2 / np.log(10))


def test_marked_altered_unclear_unseen() -> None:
    found = judged(evidence(0.1, weights=1.0 * np.concatenate([seen_half(), np.zeros(LAYOUT.chips - FIRST)])))
    assert set(found.state) == {State.MARKED, State.UNSEEN}
    assert set(judged(evidence(0.1, marked=False)).state) == {State.ALTERED}
    assert set(judged(evidence(0.1, marked=False), found=None).state) == {State.UNCLEAR}, "pictures"
    assert set(judged(evidence(0.1, marked=False), found=~ALL).state) == {State.UNCLEAR}, "only the seen are altered"
    assert set(judged(evidence(9.0, marked=False)).state) == {State.UNCLEAR}, "noise may hide half a mark"
    turned = judged(replace(evidence(0.1), y=-evidence(0.1).y))
    assert State.MARKED not in turned.state


def seen_half() -> np.ndarray:
    return np.repeat(LEAVES.of_codes < LEAVES.count // 2, len(LAYOUT.directions[0]))


def test_what_speaks_against_the_mark_discovers_nothing() -> None:
    """Both layers turned round: z far below 0."""
    chips = LAYOUT.chips + 6 * len(BALL.model)
    signs = np.where(np.random.default_rng(1).random(chips) < 0.5, 1, -1).astype(np.int8)
    said = Evidence(-1.0 * signs, np.ones(chips), np.ones(chips))
    found = judge_regions([said], signs, LEAVES, LAYOUT.chips, tries=3, found=ALL)
    assert found.z.max() < -3
    assert not found.log10_p.any()
    assert State.MARKED not in found.state


def test_a_suspicious_region_is_neither_marked_nor_altered() -> None:
    """Between the bar of one test (3.4) and that of one among many (3.8)."""
    said = evidence(0.0, marked=False)
    y = 0.05 * LAYOUT.amplitudes * SIGNS * np.where(np.arange(LAYOUT.chips) % 2, 1, -1)
    first = judged(replace(said, y=y)).partition
    inside = np.flatnonzero(np.repeat(first.of_codes == 0, len(LAYOUT.directions[0])))
    aim, c = 3.6, np.abs(y[inside])
    for k in range(len(inside)):  # chips turned in favour of the mark until z is there
        y[inside[: k + 1]] = c[: k + 1] * SIGNS[inside[: k + 1]]
        if (y[inside] * SIGNS[inside]).sum() / np.sqrt((c**2).sum()) > aim:
            break
    found = judged(replace(said, y=y))
    assert aim < found.z[0] < 3.75
    assert found.state[0] == State.UNCLEAR
    assert set(found.state[1:]) == {State.ALTERED}


def test_a_worn_mark_is_not_called_altered() -> None:
    """At half its strength, over noise as large as the mark: what `altered_rate` speaks of."""
    said = evidence(1.0)
    worn = replace(said, y=said.y - 0.5 * LAYOUT.amplitudes * SIGNS)
    assert State.ALTERED not in judged(worn).state


def test_regions_are_joined_where_the_evidence_is_thin() -> None:
    fine, thin = judged(evidence(0.3)), judged(evidence(6.0))
    assert thin.partition.count < fine.partition.count <= LEAVES.count
    (
        np.testing.assert_array_equal(
            judged(replace(evidence(6.0), y=-evidence(6.0).y)).partition.of_gaussians, thin.partition.of_gaussians
        ),
        "what is joined follows from sizes",
    )


def test_nothing_is_said_of_few_chips() -> None:
    few = np.zeros(LAYOUT.chips)
    few[: int(CONFIG.regions.least_chips) - 5] = 1.0
    found = judged(evidence(0.0, weights=few))
    assert found.tested == 0
    assert set(found.state) <= {State.UNCLEAR, State.UNSEEN}
    assert not found.z.any()


def test_discoveries_are_benjamini_and_hochbergs() -> None:
    p = np.array([0.02, 0.5, 0.001, 0.011, 0.04, 0.9])  # sorted 0.001 0.011 0.02 0.04 ...; limits 0.0083 k
    np.testing.assert_array_equal(discoveries(np.log10(p), 0.05), [True, False, True, True, False, False])
    assert not discoveries(np.log10(np.array([0.2, 0.3])), 0.05).any()
    assert not discoveries(np.zeros(0), 0.05).any()


@pytest.mark.parametrize(
    "wrong",
    [{"false_discoveries": 0.0}, {"false_discoveries": 1.0}, {"most": 48}, {"surviving": 0.0}, {"altered_rate": 2}],
)
def test_what_cannot_be_asked_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError):
        RegionConfig(**wrong)  # type: ignore[arg-type]


def test_one_leaf_is_a_partition_too() -> None:
    still = divide(replace(LAYOUT, amplitudes=np.zeros(LAYOUT.chips)), BALL.model.means, 256)
    assert isinstance(still, Partition)
    assert still.count == 1
