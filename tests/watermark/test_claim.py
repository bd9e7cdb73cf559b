"""Claims: three answers, each only when its condition holds, and fields that agree with one another."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from engine.errors import InputError
from engine.watermark.claim import Claim, ClaimConfig, Verdict, decide
from engine.watermark.keys import signs
from engine.watermark.messages import message_hex
from engine.watermark.statistics import z_threshold

SEED = bytes(range(32))
CHIPS, BITS = 4096, 32
BIT_OF = np.arange(CHIPS) % BITS
CHIP = signs(SEED, CHIPS)
MESSAGE = signs(SEED[::-1], BITS)
WEIGHTS = np.ones(CHIPS)


def claim(amplitude: float, signal: float = 0.3, seed: int = 1, **options: object) -> Claim:
    rng = np.random.default_rng(seed)
    y = rng.normal(size=CHIPS) + amplitude * CHIP * MESSAGE[BIT_OF]
    return decide(y, WEIGHTS, np.full(CHIPS, signal), BIT_OF, CHIP, MESSAGE, **options)  # type: ignore[arg-type]


def test_a_marked_suspect() -> None:
    found = claim(0.3, derived_fraction=0.9, route="model", copy="a friend", tries=3, transform={"scale": 2.0})
    assert found.verdict is Verdict.MARKED
    assert found.z > found.z_threshold == z_threshold(1e-9, 3)
    assert found.log10_false_claim == pytest.approx(-(found.z**2) / 2 / math.log(10) + math.log10(3))
    assert found.confidence == 1 - 10**found.log10_false_claim
    assert found.meets_dishonest_claimant_rate
    assert found.message == message_hex(MESSAGE)
    assert (found.matching_bits, found.bits, found.bit_accuracy) == (32, 32, 1.0)
    assert found.log10_binomial_tail == pytest.approx(-32 * math.log10(2))
    assert not found.derived_but_unmarked
    assert found.missing == ""
    assert (found.route, found.copy, found.tries, found.transform) == ("model", "a friend", 3, {"scale": 2.0})
    assert abs(found.expected_z - found.z) < 4


def test_chance_rate_without_the_stricter_one() -> None:
    found = claim(0.15)
    assert found.verdict is Verdict.MARKED
    assert not found.meets_dishonest_claimant_rate
    strict = claim(0.15, config=ClaimConfig(false_claim_rate=2.0**-128))
    assert strict.verdict is Verdict.INCONCLUSIVE
    assert strict.z == found.z
    needed = float(strict.missing.split("x")[0].removeprefix("about "))
    assert needed == pytest.approx((strict.z_threshold / strict.z) ** 2, abs=0.06)


def test_an_unmarked_suspect() -> None:
    found = claim(0.0, signal=0.5, derived_fraction=0.8)
    assert found.verdict is Verdict.NOT_MARKED
    assert found.power >= 0.999
    assert abs(found.z) < 4
    assert found.derived_but_unmarked
    assert found.missing == ""
    assert max(found.bit_reliability) < 0.95
    assert not claim(0.0, signal=0.5, derived_fraction=0.01).derived_but_unmarked
    assert not claim(0.0, signal=0.5).derived_but_unmarked


def test_too_little_evidence() -> None:
    found = claim(0.0, signal=0.08)
    assert found.verdict is Verdict.INCONCLUSIVE
    assert found.power < 0.999
    assert found.missing.startswith("about ")
    assert "more than 1000x" in claim(0.0, signal=0.001).missing
    assert not found.derived_but_unmarked


def test_power_counts_a_worn_mark() -> None:
    """The same evidence: enough for a mark at full strength, not for one at half."""
    signal = 0.2
    assert claim(0.0, signal).verdict is Verdict.INCONCLUSIVE
    full = claim(0.0, signal, config=ClaimConfig(surviving=1.0))
    assert full.verdict is Verdict.NOT_MARKED


def test_a_suspicious_z_is_never_called_unmarked() -> None:
    """A worn mark: below the threshold, yet far beyond what an unmarked suspect shows."""
    found = claim(0.11, signal=0.8)
    assert 3.8 < found.z < found.z_threshold
    assert found.power >= 0.999
    assert found.verdict is Verdict.INCONCLUSIVE
    assert "x as much" in found.missing


def test_a_negative_z_of_any_size_is_no_claim() -> None:
    """Somebody embedded the opposite message: one-sided, so this is not ours."""
    found = claim(-0.5)
    assert found.z < -20
    assert found.verdict is not Verdict.MARKED
    assert found.log10_false_claim == 0
    assert found.confidence == 0


def test_no_evidence_at_all() -> None:
    zero = np.zeros(CHIPS)
    found = decide(zero, zero, zero, BIT_OF, CHIP, MESSAGE)
    assert found.verdict is Verdict.INCONCLUSIVE
    assert "nothing of the reference" in found.missing
    assert (found.z, found.confidence, found.matching_bits, found.bit_accuracy) == (0, 0, 0, 0)
    absent = decide(zero, zero, zero, BIT_OF, CHIP, MESSAGE, absence_power=0.9999, derived_fraction=0.0)
    assert absent.verdict is Verdict.NOT_MARKED
    assert absent.power == 0.9999
    assert not absent.derived_but_unmarked


def test_tries_raise_the_bar() -> None:
    one, many = claim(0.15), claim(0.15, tries=10**6)
    assert many.z == one.z
    assert many.z_threshold > one.z_threshold
    assert many.log10_false_claim == pytest.approx(one.log10_false_claim + 6)
    with pytest.raises(ValueError, match="tried"):
        claim(0.12, tries=0)


def test_json_is_plain_and_complete() -> None:
    found = claim(0.3, notes=("first", "second"), transform={"scale": 1.0})
    plain = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert plain["verdict"] == "marked"
    assert set(plain) == set(Claim.__dataclass_fields__)
    assert len(plain["bit_reliability"]) == BITS
    assert plain["notes"] == ["first", "second"]
    assert replace(found) == found


@pytest.mark.parametrize(
    "wrong", [{"false_claim_rate": 0.0}, {"power": 1.0}, {"doubt_rate": 2.0}, {"surviving": 0.0}, {"derived_least": 2}]
)
def test_config_is_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        ClaimConfig(**wrong)


def test_a_bit_of_which_little_was_to_be_seen_is_not_trusted() -> None:
    """A crop: half of the bits had hardly a signal to expect, and the noise there reads as a bit all the same."""
    weak = BIT_OF >= BITS // 2
    signal = np.where(weak, 1e-4, 0.5)
    y = np.random.default_rng(4).normal(size=CHIPS) + np.where(weak, 0.0, 0.5) * CHIP * MESSAGE[BIT_OF]
    found = decide(y, WEIGHTS, signal, BIT_OF, CHIP, MESSAGE)
    assert min(found.bit_reliability[: BITS // 2]) > 0.99
    assert max(found.bit_reliability[BITS // 2 :]) < 0.55
