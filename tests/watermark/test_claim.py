"""Claims: three answers, each only when its condition holds, and fields that agree with one another."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from engine.errors import InputError
from engine.watermark.claim import Circumstances, Claim, ClaimConfig, Derivation, Transform, Verdict, decide
from engine.watermark.keys import signs
from engine.watermark.messages import message_hex
from engine.watermark.model_evidence import Evidence
from engine.watermark.rates import DRAWS, Attested, applicable_rate
from engine.watermark.spreading import Spreading
from engine.watermark.statistics import CHANCE_RATE, z_threshold

SEED = bytes(range(32))
CHIPS, BITS = 4096, 32
BIT_OF = np.arange(CHIPS) % BITS
CHIP = signs(SEED, CHIPS)
MESSAGE = signs(SEED[::-1], BITS)
WEIGHTS = np.ones(CHIPS)
SPREADING = Spreading(BIT_OF, CHIP)


FOUND = Derivation(True, 0.8, 1000)


MOVED = Transform(2.0, np.eye(3).tolist(), [0.0, 0.0, 0.0])


def claim(
    amplitude: float,
    signal: float = 0.3,
    seed: int = 1,
    noise: float = 1.0,
    config: ClaimConfig | None = None,
    **known: object,
) -> Claim:
    rng = np.random.default_rng(seed)
    y = noise * rng.normal(size=CHIPS) + amplitude * CHIP * MESSAGE[BIT_OF]
    evidence = Evidence(y, WEIGHTS, np.full(CHIPS, signal))
    return decide(evidence, SPREADING, MESSAGE, Circumstances(**known), config)  # type: ignore[arg-type]


def test_a_marked_suspect() -> None:
    found = claim(0.3, derivation=FOUND, route="model", copy="a friend", tries=3, transform=MOVED)
    assert found.verdict is Verdict.MARKED
    assert found.z > found.z_threshold == z_threshold(1e-9, 3)
    assert found.log10_false_claim == pytest.approx(-(found.z**2) / 2 / math.log(10) + math.log10(3))
    assert found.confidence == 1 - 10**found.log10_false_claim
    assert found.meets_dishonest_claimant_rate
    assert found.message == message_hex(MESSAGE)
    assert (found.matching_bits, found.bits, found.bit_accuracy) == (32, 32, 1.0)
    assert found.log10_binomial_tail == pytest.approx(-32 * math.log10(2))
    assert found.derivation == FOUND
    assert not found.would_be_claim_if_attested
    assert found.missing == ""
    assert (found.route, found.copy, found.tries, found.transform) == ("model", "a friend", 3, MOVED)
    assert abs(found.expected_z - found.z) < 4


def test_chance_rate_without_the_stricter_one() -> None:
    found = claim(0.15)
    assert found.verdict is Verdict.MARKED
    assert not found.meets_dishonest_claimant_rate
    strict = claim(0.15, config=ClaimConfig(false_claim_rate=2.0**-128))
    assert strict.verdict is Verdict.INCONCLUSIVE
    assert strict.z == found.z
    needed = float(strict.missing.partition("about ")[2].split()[0])
    assert needed == pytest.approx((strict.z_threshold / strict.z) ** 2, abs=0.06)


def test_evidence_between_the_two_rates_would_be_a_claim() -> None:
    """A record that nobody attests may have been chosen out of very many."""
    unattested = ClaimConfig.at(applicable_rate(1e-9, None))
    between = claim(0.15, config=unattested, derivation=FOUND)
    assert (between.verdict, between.would_be_claim_if_attested) == (Verdict.INCONCLUSIVE, True)
    assert (between.false_claim_rate, between.rate_basis) == (2.0**-128, "self_declared")
    weak, strong = claim(0.05, config=unattested), claim(0.3, config=unattested)
    assert (weak.verdict, weak.would_be_claim_if_attested) == (Verdict.INCONCLUSIVE, False)
    assert (strong.verdict, strong.would_be_claim_if_attested) == (Verdict.MARKED, False)
    older = claim(0.15, config=ClaimConfig.at(applicable_rate(1e-9, Attested("2026-01-01", "x"), "2025-01-01")))
    assert (older.verdict, older.would_be_claim_if_attested) == (Verdict.INCONCLUSIVE, False)


def test_requests_to_who_drew_are_hypotheses_of_the_claim_and_not_of_the_copy() -> None:
    attested = Attested("2026-01-01", "x", drawn=True)
    plain = claim(0.2, config=ClaimConfig.at(applicable_rate(1e-9, None)), copy_z=7.5)
    drawn = claim(0.2, config=ClaimConfig.at(applicable_rate(1e-9, attested)), copy_z=7.5)
    assert drawn.tries == DRAWS * plain.tries
    assert drawn.log10_false_claim == pytest.approx(plain.log10_false_claim + math.log10(DRAWS))
    assert drawn.z_threshold == pytest.approx(z_threshold(CHANCE_RATE, drawn.tries))
    assert drawn.copy_named == plain.copy_named
    assert drawn.copy_named
    weak = [claim(0.15, config=ClaimConfig.at(applicable_rate(1e-9, each))) for each in (None, attested)]
    assert [one.verdict for one in weak] == [Verdict.INCONCLUSIVE] * 2
    assert weak[0].would_be_claim_if_attested, "enough at 1e-9, where nothing was tried out"


def test_an_unmarked_suspect() -> None:
    found = claim(0.0, signal=0.5, noise=0.1, derivation=FOUND)
    assert found.verdict is Verdict.NOT_MARKED
    assert found.power >= 0.999
    assert found.change == pytest.approx(0.2, abs=0.01)
    assert abs(found.z) < 4
    assert found.derivation.derived
    assert found.missing == ""
    assert max(found.bit_reliability) < 0.95


def test_nothing_found_is_never_called_unmarked() -> None:
    """Mirrored, merged or disguised: where the asset was not found its mark was not looked for."""
    for derivation in (Derivation(False), Derivation(False, 0.01, 90)):
        found = claim(0.0, signal=0.5, noise=0.1, derivation=derivation)
        assert found.power >= 0.999
        assert found.verdict is Verdict.INCONCLUSIVE
        assert "too little of the asset" in found.missing


@pytest.mark.parametrize("correlation", [0.5, 0.7, 0.9, 0.95])
def test_a_mark_that_was_covered_is_never_called_absent(correlation: float) -> None:
    """Who cleans a stolen model subtracts an estimate of its mark until Z is gone; what he leaves gives him away."""
    mark = 0.5 * CHIP * MESSAGE[BIT_OF]
    wrong = math.sqrt(1 / correlation**2 - 1) * 0.5 * np.random.default_rng(5).normal(size=CHIPS)
    wrong -= mark * (wrong @ mark) / (mark @ mark)  # exactly nothing of the mark is left
    found = decide(Evidence(wrong, WEIGHTS, np.full(CHIPS, 0.5)), SPREADING, MESSAGE, Circumstances(derivation=FOUND))
    assert abs(found.z) < 1e-6
    assert found.change == pytest.approx(math.sqrt(1 / correlation**2 - 1), rel=0.05)
    assert found.verdict is Verdict.INCONCLUSIVE
    assert found.derivation.derived


def test_who_has_the_original_leaves_no_trace_but_the_derivation() -> None:
    found = decide(
        Evidence(np.zeros(CHIPS), WEIGHTS, np.full(CHIPS, 0.5)), SPREADING, MESSAGE, Circumstances(derivation=FOUND)
    )
    assert (found.verdict, found.change, found.derivation.derived) == (Verdict.NOT_MARKED, 0.0, True)


def test_too_little_evidence() -> None:
    found = claim(0.0, signal=0.08, derivation=FOUND)
    assert found.verdict is Verdict.INCONCLUSIVE
    assert found.power < 0.999
    assert f"z {found.z:.1f} of the {found.z_threshold:.1f}" in found.missing
    assert "half strength" in found.missing
    assert "1,000" in claim(0.0, signal=0.001, derivation=FOUND).missing


def pictures(shown: int, amplitude: float) -> Claim:
    """Of so many pictures of one copy, equally clear, at the rate of a record that nobody attests.

    Their noise is orthogonal to the mark.
    """
    noise = np.random.default_rng(1).normal(size=CHIPS)
    sign = (CHIP * MESSAGE[BIT_OF]).astype(np.float64)
    noise -= sign * (noise @ sign) / CHIPS
    evidence = Evidence(math.sqrt(shown) * noise + shown * amplitude * sign, WEIGHTS, np.full(CHIPS, 0.1 * shown))
    known = Circumstances(6, "image", derivation=Derivation(True, views=(shown, shown)))
    return decide(evidence, SPREADING, MESSAGE, known, ClaimConfig.at(applicable_rate(1e-9, None)))


def test_as_many_more_pictures_as_named_do() -> None:
    """z of pictures of one copy adds up as a root of a sum of squares."""
    for shown in (1, 2):
        some = pictures(shown, 0.11)
        assert some.verdict is Verdict.INCONCLUSIVE
        assert f"z {some.z:.1f} of the {some.z_threshold:.1f}" in some.missing
        more = int(some.missing.partition("about ")[2].split()[0])
        assert pictures(shown + more, 0.11).verdict is Verdict.MARKED
        assert pictures(shown + more - 1, 0.11).verdict is Verdict.INCONCLUSIVE


def test_what_is_no_more_than_chance_promises_nothing() -> None:
    for amplitude in (0.0, 0.02):
        found = pictures(1, amplitude)
        assert f"z {found.z:.1f} of the {found.z_threshold:.1f}" in found.missing
        assert "more" not in found.missing
        assert not re.search("pictures|removed|covered|another", found.missing)


def test_what_an_older_registration_would_need_is_said_until_it_is_reached() -> None:
    lower = z_threshold(1e-9, 6)
    for amplitude, below in ((0.085, True), (0.13, False)):
        found = pictures(1, amplitude)
        assert (found.z < lower) == below
        assert found.would_be_claim_if_attested != below
        assert (f"z {lower:.1f} would do" in found.missing) == below


def test_covering_is_only_spoken_of_where_a_mark_would_have_been_seen() -> None:
    for signal in (0.05, 0.1, 0.3, 0.6):
        found = claim(0.0, signal, derivation=Derivation(True, views=(1, 1)), route="image")
        assert ("removed" in found.missing) == (found.power >= 0.999)
    assert found.power >= 0.999


def test_power_counts_a_worn_mark() -> None:
    """The same evidence: enough for a mark at full strength, not for one at half."""
    anything = ClaimConfig(room=10.0)
    assert claim(0.0, 0.2, config=anything, derivation=FOUND).verdict is Verdict.INCONCLUSIVE
    full = claim(0.0, 0.2, config=replace(anything, surviving=1.0), derivation=FOUND)
    assert full.verdict is Verdict.NOT_MARKED


def test_a_suspicious_z_is_never_called_unmarked() -> None:
    """A worn mark: below the threshold, yet far beyond what an unmarked suspect shows."""
    found = claim(0.011, signal=0.8, noise=0.1, derivation=FOUND)
    assert 3.8 < found.z < found.z_threshold
    assert found.power >= 0.999
    assert found.verdict is Verdict.INCONCLUSIVE
    assert "times as much" in found.missing


def test_a_z_far_below_zero_is_never_called_unmarked() -> None:
    """Somebody subtracted more than the mark: it was there."""
    found = claim(-0.011, signal=0.8, noise=0.1, derivation=FOUND)
    assert found.z < -4
    assert found.power >= 0.999
    assert found.change is not None
    assert found.change < 0.25
    assert found.verdict is Verdict.INCONCLUSIVE
    assert "removed" in found.missing


def test_no_layer_may_leave_room_for_the_mark() -> None:
    """Colours as the original has them, centres roughened: the mark was in the layer that was covered."""
    quiet = {"both": 0.4, "tint": 0.5, "grain": -0.3}
    assert claim(0.0, 0.5, noise=0.1, derivation=FOUND, layers=quiet, change=0.2).verdict is Verdict.NOT_MARKED
    covered = claim(0.0, 0.5, noise=0.1, derivation=FOUND, layers=quiet, change=1.1)
    assert (covered.verdict, covered.change) == (Verdict.INCONCLUSIVE, 1.1)
    assert "removed" in covered.missing
    turned = claim(0.0, 0.5, noise=0.1, derivation=FOUND, layers={**quiet, "grain": -9.0}, change=0.2)
    assert turned.verdict is Verdict.INCONCLUSIVE
    assert "removed" in turned.missing


def test_a_negative_z_of_any_size_is_no_claim() -> None:
    """Somebody embedded the opposite message: one-sided, so this is not ours."""
    found = claim(-0.5)
    assert found.z < -20
    assert found.verdict is not Verdict.MARKED
    assert found.log10_false_claim == 0
    assert found.confidence == 0


def test_no_evidence_at_all() -> None:
    zero = np.zeros(CHIPS)
    found = decide(Evidence(zero, zero, zero), SPREADING, MESSAGE)
    assert found.verdict is Verdict.INCONCLUSIVE
    assert "no part of the asset" in found.missing
    assert (found.z, found.confidence, found.matching_bits, found.bit_accuracy) == (0, 0, 0, 0)
    shown = Circumstances(1, "image", derivation=Derivation(True, views=(1, 1)))
    found = decide(Evidence(zero, zero, zero), SPREADING, MESSAGE, shown)
    assert "the pictures show the asset, but too coarsely" in found.missing


def test_tries_raise_the_bar() -> None:
    one, many = claim(0.15), claim(0.15, tries=10**6)
    assert many.z == one.z
    assert many.z_threshold > one.z_threshold
    assert many.log10_false_claim == pytest.approx(one.log10_false_claim + 6)
    with pytest.raises(ValueError, match="tried"):
        claim(0.12, tries=0)


def test_json_is_plain_and_complete() -> None:
    found = claim(0.3, notes=("first", "second"), transform=MOVED)
    plain = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert plain["verdict"] == "marked"
    assert set(plain) == {*Claim.__dataclass_fields__, "derived", "derived_fraction"}
    assert len(plain["bit_reliability"]) == BITS
    assert plain["notes"] == ["first", "second"]
    assert replace(found) == found


@pytest.mark.parametrize(
    "wrong", [{"false_claim_rate": 0.0}, {"power": 1.0}, {"doubt_rate": 2.0}, {"surviving": 0.0}, {"room": 0.0}]
)
def test_config_is_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        ClaimConfig(**wrong)


def test_a_bit_of_which_little_was_to_be_seen_is_not_trusted() -> None:
    """A crop: half of the bits had hardly a signal to expect, and the noise there reads as a bit all the same."""
    weak = BIT_OF >= BITS // 2
    signal = np.where(weak, 1e-4, 0.5)
    y = np.random.default_rng(4).normal(size=CHIPS) + np.where(weak, 0.0, 0.5) * CHIP * MESSAGE[BIT_OF]
    found = decide(Evidence(y, WEIGHTS, signal), SPREADING, MESSAGE)
    assert min(found.bit_reliability[: BITS // 2]) > 0.99
    assert max(found.bit_reliability[BITS // 2 :]) < 0.55
