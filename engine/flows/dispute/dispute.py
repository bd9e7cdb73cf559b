"""The dispute: two parties say that one model is theirs. Whose mark is in the other's original?

A mark that a thief adds to a stolen model is a true one, so both claims can hold. But the thief's original was made
from the owner's marked model, and the owner's original from nothing of the thief's:

1. Both marks are looked for in both originals (the sealed references), and in both published models.
2. The one whose mark is in the other's original came first. Both, or neither: said so.
3. Times that others attest are compared, and what was done is named where it shows.

Every mark must reach 2^-128, whatever is attested: a dispute is between people of whom one lies.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace

import numpy as np

from engine.flows.progress import Progress
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.verify.decision import VerifyConfig
from engine.flows.verify.search import Suspect, verify
from engine.model import GaussianModel
from engine.numerics.plain import Json, plain
from engine.watermark.claim import Claim, Verdict
from engine.watermark.config import CONFIG as WATERMARK
from engine.watermark.rates import moment
from engine.watermark.statistics import DISHONEST_CLAIMANT_RATE

COPIED = 0.25 * WATERMARK.planning.mark_scale
"""Largest typical difference of colours, SH units, between a model and its copy: a quarter of what a mark moves. Trade
formats round to less."""


@dataclass(frozen=True, eq=False)
class Party:
    """One of the two: a record, opened with its key, and the model that was published."""

    opened: OpenedRecord
    model: GaussianModel


@dataclass(frozen=True)
class Look:
    """One party's mark, looked for in one model."""

    mark_of: str  # "a" or "b"
    place: str  # "a", "b": whose model
    kind: str  # "original" (the sealed reference) or "published"
    marked: bool
    claim: Claim

    def to_json(self) -> Json:
        """Plain values."""
        names = ("verdict", "z", "z_threshold", "log10_false_claim", "matching_bits", "bits", "route", "change")
        claim = self.claim.to_json()
        shown = {name: claim[name] for name in (*names, "derivation")}
        return {"mark_of": self.mark_of, "place": self.place, "kind": self.kind, "marked": self.marked, **shown}


@dataclass(frozen=True)
class Date:
    """When a party's record was registered, as the party says and as others attest."""

    self_declared: str  # may be empty
    attested: str  # UTC, ISO 8601; empty where it is not attested
    attested_by: str


@dataclass(frozen=True)
class Dispute:
    """What the two records and models say."""

    first: str  # "a" or "b", whose mark is in the other's original; "both" or "neither"
    looks: tuple[Look, ...]
    dates: dict[str, Date]  # by party
    registered_first: str  # by attested times: "a" or "b"; empty where not both are attested
    same_original: bool  # the two originals are one asset, or one is made from the other
    seen: tuple[tuple[str, str], ...]  # what was done, and by whom: keys of `dispute_text.DEEDS`
    records: dict[str, dict[str, str]]  # by party: record_id, owner, original_sha256

    def to_json(self) -> Json:
        """Plain dict of JSON values."""
        found: Json = plain({**asdict(replace(self, looks=())), "looks": [one.to_json() for one in self.looks]})
        return found


def settle(a: Party, b: Party, progress: Progress | None = None) -> Dispute:
    """Settle who came first, from what both parties brought."""
    looks = tuple(_looks({"a": a, "b": b}, progress or (lambda stage, fraction: None)))
    found = {(one.mark_of, one.place, one.kind): one for one in looks}
    a_in_b, b_in_a = found["a", "b", "original"], found["b", "a", "original"]
    first = {(True, False): "a", (False, True): "b", (True, True): "both", (False, False): "neither"}[
        a_in_b.marked, b_in_a.marked
    ]
    parties = {"a": a, "b": b}
    dates = {name: _date(party) for name, party in parties.items()}
    same = a_in_b.claim.derivation.derived or b_in_a.claim.derivation.derived or a_in_b.marked or b_in_a.marked
    return Dispute(
        first,
        looks,
        dates,
        _earlier(a, b),
        same,
        tuple(_deeds(first, found, parties, dates)),
        {name: _record(party.opened) for name, party in parties.items()},
    )


def _looks(parties: dict[str, Party], progress: Progress) -> Iterator[Look]:
    """Both marks in both originals, then in both published models."""
    config = VerifyConfig(false_claim_rate=DISHONEST_CLAIMANT_RATE)
    # A mark is never in the original that its own chips were drawn for: that case is not tested.
    questions = [("a", "b", "original"), ("b", "a", "original")]
    questions += [(mark, place, "published") for mark in "ab" for place in "ab"]
    for number, (mark, place, kind) in enumerate(questions):
        progress(f"{kind} of {place}", number / len(questions))
        model = parties[place].opened.reference if kind == "original" else parties[place].model
        claim = verify(Suspect(model), parties[mark].opened, config).claim
        yield Look(mark, place, kind, claim.verdict is Verdict.MARKED, claim)


def _deeds(
    first: str, found: dict[tuple[str, str, str], Look], parties: dict[str, Party], dates: dict[str, Date]
) -> Iterator[tuple[str, str]]:
    """What was done, by whom, where it shows."""
    headers = {name: party.opened.header for name, party in parties.items()}
    if headers["a"].reference_digest == headers["b"].reference_digest:
        yield "same original", ""
    elif any(found[mark, place, "original"].claim.verdict is Verdict.NOT_MARKED for mark, place in ("ab", "ba")):
        yield "equal originals", ""
    for place in "ab":
        claims = [found[mark, place, "published"].claim for mark in "ab"]
        none = all(claim.verdict is not Verdict.MARKED for claim in claims)
        if none and any(claim.derivation.derived for claim in claims):
            yield "unmarked", place
    if first not in ("a", "b"):
        return
    owner, thief = first, "b" if first == "a" else "a"
    own, theirs = found[thief, thief, "published"].marked, found[owner, thief, "published"].marked
    copied = _same_colors(parties[thief].opened.reference, parties[owner].model)
    if copied:
        yield "copying", thief
    if own:
        yield "re-marking", thief
        if theirs:
            yield "overwriting", thief
    elif not copied:
        yield "inversion", thief
    said = dates[thief].self_declared
    known = dates[owner].attested or dates[owner].self_declared
    if said and (_before(said, known) or (dates[thief].attested and _before(said, dates[thief].attested))):
        yield "back-dating", thief


def _same_colors(one: GaussianModel, two: GaussianModel) -> bool:
    """Whether two models are the same Gaussians in the same colors."""
    if len(one) != len(two):
        return False
    gap = one.sh[:, 0].astype(np.float64) - two.sh[:, 0]
    return bool(np.sqrt(np.median(gap**2)) <= COPIED)


def _date(party: Party) -> Date:
    attested = party.opened.attested
    declared = party.opened.header.registered_at
    return Date(declared, attested.at if attested else "", attested.by if attested else "")


def _earlier(a: Party, b: Party) -> str:
    """Who registered first, by what others attest of both."""
    one, two = a.opened.attested, b.opened.attested
    if one is None or two is None or one.moment == two.moment:
        return ""
    return "a" if one.moment < two.moment else "b"


def _before(one: str, two: str) -> bool:
    """Whether a time is earlier than another; False where either is none."""
    try:
        return moment(one) < moment(two)
    except ValueError:
        return False


def _record(opened: OpenedRecord) -> dict[str, str]:
    header = opened.header
    return {"record_id": header.record_id, "owner": header.owner, "original_sha256": header.original_digest}
