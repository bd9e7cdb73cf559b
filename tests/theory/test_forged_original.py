"""Craver's inversion attack: a forged "original" made from another owner's marked model.

The attacker takes a public marked model, subtracts a mark of his own under his key, and registers the
difference as his original. Were chips drawn from his key alone, the model minus his original would be his
mark: a perfect claim. Chips bound to the digest of the original defeat it: subtracting changes the original,
hence the chips.
"""

from __future__ import annotations

import numpy as np

from engine.model import GaussianModel
from engine.records.record import Record, chip_context, make_record_id
from engine.records.reference import decode_reference, encode_reference, reference_digest
from engine.watermark.claim import Claim, Verdict, decide
from engine.watermark.keys import CHIPS, OwnerKey, signs
from engine.watermark.model_evidence import Evidence
from engine.watermark.spreading import Spreading

N, BITS, AMPLITUDE = 2048, 32, 1 / 64  # the amplitude lies on the grid of DC
BIT_OF = np.arange(3 * N) % BITS
MESSAGE = signs(bytes(32), BITS)
PLAN = {"message": "the attacker's"}
OWNER, ATTACKER = OwnerKey(bytes(range(32))), OwnerKey(bytes(range(1, 33)))


def honest_model() -> GaussianModel:
    rng = np.random.default_rng(2)
    quats = rng.normal(size=(N, 4))
    return GaussianModel(
        rng.normal(size=(N, 3)), rng.normal(-4, 1, size=(N, 3)), quats, rng.normal(size=N), rng.normal(size=(N, 1, 3))
    )


def bound_chips(key: OwnerKey, original: GaussianModel) -> np.ndarray:
    """As the product draws them: from the key and the canonical original it opened."""
    digest = reference_digest(encode_reference(original))
    record_id = make_record_id(key, digest, "", PLAN, {})
    return signs(key.derive(CHIPS, chip_context(digest, record_id)), 3 * N)


def unbound_chips(key: OwnerKey, original: GaussianModel) -> np.ndarray:
    """The mistake: from the key alone."""
    return signs(key.derive(CHIPS, b""), 3 * N)


def mark(chips: np.ndarray) -> np.ndarray:
    return (AMPLITUDE * chips * MESSAGE[BIT_OF]).reshape(N, 3)


def add(model: GaussianModel, displacement: np.ndarray) -> GaussianModel:
    return model.with_dc(model.sh[:, 0] + displacement.astype(np.float32))


def claim(suspect: GaussianModel, original: GaussianModel, chips: np.ndarray) -> Claim:
    reference = decode_reference(encode_reference(original))
    y = (suspect.sh[:, 0] - reference.sh[:, 0]).reshape(-1).astype(np.float64)
    return decide(Evidence(y, np.ones(3 * N), np.full(3 * N, AMPLITUDE)), Spreading(BIT_OF, chips), MESSAGE)


def published() -> tuple[GaussianModel, GaussianModel]:
    """The true owner's original, and the marked model the world can see."""
    original = decode_reference(encode_reference(honest_model()))
    return original, add(original, mark(bound_chips(OWNER, original)))


def test_the_true_owner_claims() -> None:
    original, public = published()
    assert claim(public, original, bound_chips(OWNER, original)).meets_dishonest_claimant_rate


def test_unbound_chips_would_let_the_attacker_claim() -> None:
    _, public = published()
    forged = add(public, -mark(unbound_chips(ATTACKER, public)))
    stolen = claim(public, forged, unbound_chips(ATTACKER, forged))
    assert stolen.verdict is Verdict.MARKED
    assert stolen.log10_false_claim < -1000


def test_bound_chips_defeat_the_forged_original() -> None:
    """Also when he goes round and round: subtract the mark of the last forgery, hash again."""
    _, public = published()
    forged = public
    for _ in range(20):
        forged = add(public, -mark(bound_chips(ATTACKER, forged)))
        attempt = claim(public, forged, bound_chips(ATTACKER, forged))
        assert attempt.verdict is not Verdict.MARKED
        assert not attempt.meets_dishonest_claimant_rate
        assert abs(attempt.z) < 5


def test_fitting_the_plan_to_the_chips_changes_the_chips() -> None:
    """The other loose end: given chips, deal the bits to agree. But the dealing is part of the id."""
    _, public = published()
    forged = add(public, 0.01 * np.random.default_rng(4).normal(size=(N, 3)))
    reference_arrays = encode_reference(forged)
    y = (public.sh[:, 0] - decode_reference(reference_arrays).sh[:, 0]).reshape(-1).astype(np.float64)

    def z_of(dealing: np.ndarray, chips: np.ndarray) -> Claim:
        return decide(Evidence(y, np.ones(3 * N), np.full(3 * N, 0.01)), Spreading(dealing, chips), MESSAGE)

    plain = Record.make(ATTACKER, reference_arrays, original_digest="0" * 64, plan=(PLAN, {"bit_of": BIT_OF}))
    chips = signs(ATTACKER.derive(CHIPS, plain.header.chip_context()), 3 * N)
    plus, minus = int(np.argmax(MESSAGE)), int(np.argmin(MESSAGE))
    fitted = np.where(y * chips > 0, plus, minus)
    assert z_of(fitted, chips).meets_dishonest_claimant_rate  # with yesterday's chips it would be a claim ...
    again = Record.make(ATTACKER, reference_arrays, original_digest="0" * 64, plan=(PLAN, {"bit_of": fitted}))
    opened = Record.from_bytes(again.to_bytes(ATTACKER), ATTACKER)
    redrawn = signs(ATTACKER.derive(CHIPS, opened.header.chip_context()), 3 * N)
    assert abs(z_of(fitted, redrawn).z) < 5  # ... but the record that holds this dealing draws others
