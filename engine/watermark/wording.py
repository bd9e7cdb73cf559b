"""A claim in words: the one wording of it, for command line, report, API and page.

Said of the plain JSON of `verify --json`. Nothing is overstated: bounds are rounded against the claim, and nothing
measured is called certain.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from engine.watermark.claim import SCATTERED
from engine.watermark.numerals import Form, percent, surely, when
from engine.watermark.rates import BASES
from engine.watermark.statistics import DISHONEST_CLAIMANT_RATE

HEADLINES = {"marked": "Mark found", "not_marked": "Derived, without this mark", "inconclusive": "Undecided"}

ROUTES = {
    "model": "the suspect's Gaussians, compared one by one with the registered original",
    "both": "the suspect's Gaussians, one by one, and what it shows at the owner's secret views, added up",
    "render": "the suspect model seen at the owner's secret views, as a black box",
    "image": "the pictures, compared with renders of the registered original",
}


@dataclass(frozen=True)
class Fact:
    """Something that was found; `leading` are the few that a reader looks for first."""

    label: str
    text: str
    leading: bool = False


@dataclass(frozen=True)
class Words:
    """A claim in words."""

    # The verdict in two words, and in one sentence
    headline: str
    finding: str
    facts: tuple[Fact, ...]  # the leading ones first
    meaning: dict[str, str]  # `says`, `does_not_say`, `method` and `record_time`
    limits: tuple[tuple[float, str], ...]  # what a bound is held against: the rate that applies, and 2^-128


def words_of(claim: Mapping[str, Any], form: Form, *, suspect: str = "", pictures: int = 0) -> Words:
    """A claim in words.

    Parameters
    ----------
    claim : mapping
        Keys of `verify --json`; `message` is None and `record_id` empty where nothing could be compared. `searched`
        says among how many `assets` the suspect was looked for, where no single one was named.
    suspect : str
        Its name; left out, it is "this model" or "these pictures".
    pictures : int
        How many were looked at; 0 for a model.
    """
    against = [(math.log10(DISHONEST_CLAIMANT_RATE), f"without an attested date: 1 in {form.power(2, 128)}")]
    rate = claim["false_claim_rate"]
    if rate is not None and rate != DISHONEST_CLAIMANT_RATE:
        against.append((math.log10(rate), f"needed here: {form.rate(rate)}"))
        against.sort(reverse=True)
    return Words(
        headline=HEADLINES[claim["verdict"]] if _recognised(claim) else "Not recognised",
        finding=_finding(claim, form, suspect, pictures),
        facts=tuple(sorted(_facts(claim, form), key=lambda fact: not fact.leading)),
        meaning={
            "says": _says(claim, form),
            "does_not_say": _does_not_say(claim),
            "method": (
                "The comparison used the owner's sealed record, which holds the unmarked original and the secret"
                " positions of the mark; nobody can repeat it without that record and the owner's key."
            ),
            "record_time": _record_time(claim, form),
        },
        limits=tuple(against),
    )


def _finding(claim: Mapping[str, Any], form: Form, suspect: str, pictures: int) -> str:
    kind = {0: "model", 1: "picture"}.get(pictures, "pictures")
    this = suspect or f"{'These' if pictures > 1 else 'This'} {kind}"
    derived = f"{this} {'are' if pictures > 1 and not suspect else 'is'} derived from your asset"
    if claim["verdict"] == "not_marked":
        return f"{derived}; this copy's mark is absent or was taken out."
    if claim["verdict"] == "inconclusive":
        it = suspect or f"the {kind}"
        if claim["would_be_claim_if_attested"]:
            return f"{_WOULD}." + (f" {derived}." if claim["derivation"]["derived"] else "")
        if claim["derivation"]["derived"]:
            return f"{derived}; whether this copy's mark is in it, the evidence does not decide."
        return f"{_nothing_of(claim)} was recognised in {it}."
    whose = f"the copy made for {form.name(claim['copy'])}" if claim["copy"] else "the registered model"
    shows = {0: "contains", 1: "shows"}.get(pictures, "show")
    return f"{this} {shows} {whose}, or something made from it: its hidden mark was found."


def _recognised(claim: Mapping[str, Any]) -> bool:
    return bool(
        claim["verdict"] != "inconclusive" or claim["derivation"]["derived"] or claim["would_be_claim_if_attested"]
    )


def _nothing_of(claim: Mapping[str, Any]) -> str:
    """What was not found: the one asset that was named, or one of all."""
    if not (searched := claim.get("searched")) or searched["scope"] == "one":
        return "Nothing of your asset"
    if searched["assets"] == 1:
        return "Nothing of your registered asset"
    return f"None of your {searched['assets']} registered assets"


_WOULD = "This would be a claim if the registration were attested by somebody else, before the suspect was known"


def _facts(claim: Mapping[str, Any], form: Form) -> list[Fact]:
    found = []
    if claim["message"] is not None:
        tried = f"{claim['tries']} {'try' if claim['tries'] == 1 else 'tries'} counted"
        odds, needed = form.odds(claim["log10_false_claim"]), _needed(claim, form)
        found.append(Fact("false claim", f"{odds}, {tried} (needed: {needed})", leading=True))
        bits = f"{claim['message']}: {claim['matching_bits']} of {claim['bits']} bits as registered"
        found.append(Fact("message read", f"{bits}, {_sureness(claim)}", leading=True))
    found.append(Fact("derived", derivation_text(claim["derivation"]), leading=True))
    if claim["verdict"] == "not_marked":
        found.append(Fact("missed mark", f"{surely(claim['power'])} sure that {_WOULD_SHOW}", leading=True))
    if claim["missing"]:
        found.append(Fact("missing", claim["missing"], leading=True))
    if claim["transform"] is not None and "scale" in claim["transform"]:
        turn, scale = _angle(claim["transform"]["rotation"]), 1.0 / claim["transform"]["scale"]
        first = "mirrored, then " if claim["transform"].get("mirrored") else ""
        found.append(Fact("moved", f"{first}turned by {turn:.1f} degrees and scaled by {scale:.4g}"))
    if claim["route"]:
        found.append(Fact("evidence", ROUTES.get(claim["route"], claim["route"])))
    if layers := claim.get("layers"):
        grain = f", in centres and sizes z {layers['grain']:.1f}" if "grain" in layers else ""
        scattered = [z for name, z in layers.items() if name.endswith(SCATTERED)]
        other = f"; weighed by their scatter {max(scattered):.1f}" if scattered else ""
        found.append(Fact("layers", f"in colours z {layers['tint']:.1f}{grain}, together {layers['both']:.1f}{other}"))
    if claim["copy"]:
        found.append(Fact("copy", f"the one made for {form.name(claim['copy'])}"))
    if claim["record_id"]:
        key = f" of key {claim['owner']}" if claim.get("owner") else ""
        found.append(Fact("record", f"{claim['record_id']}{key}, {dated(claim)}"))
    if claim["rate_basis"]:
        found.append(Fact("rate", f"{_needed(claim, form)}: {BASES[claim['rate_basis']]}"))
    return found + [Fact("note", note) for note in claim["notes"]]


def _sureness(claim: Mapping[str, Any]) -> str:
    if claim["verdict"] != "marked":
        return f"where coins would give about {claim['bits'] // 2}"
    return f"the weakest {surely(min(claim['bit_reliability']))} sure"


_WOULD_SHOW = (
    "this copy's mark, had it been there and had nobody worked against it, would have been seen, even worn to half its"
    " strength"
)


def _needed(claim: Mapping[str, Any], form: Form) -> str:
    rate = claim["false_claim_rate"]
    return f"1 in {form.power(2, 128)}" if rate == DISHONEST_CLAIMANT_RATE else form.rate(rate)


def derivation_text(derivation: Mapping[str, Any]) -> str:
    """How much of the asset is in the suspect, how exactly and where."""
    if (views := derivation["views"]) is not None:
        shown, of = views
        return f"yes: {shown} of {of} pictures show your asset" if shown else "no picture was recognised"
    share = derivation["share"]
    if not derivation["derived"]:
        return f"not shown: {percent(share)} of your asset was found in the suspect" if share else "not shown"
    if share is None:
        return "yes: the suspect looks like your asset from several sides, though its Gaussians are others"
    text = f"yes: {percent(share)} of your asset was found in the suspect"
    if (count := derivation["gaussians"]) is not None:
        text += f" ({count:,} Gaussians)"
    if (gap := derivation["exactness"]) is not None:
        text += f", half of them within {gap:.2g} of their own size of where the original has them"
    if (where := derivation["where"]) is not None:
        low, high = (", ".join(f"{value:.3g}" for value in corner) for corner in where)
        text += f", from ({low}) to ({high}) of the original"
    return text


def dated(claim: Mapping[str, Any]) -> str:
    """When the record was registered, and who says so."""
    parts = []
    if claim["registered_at"]:
        parts.append(f"registered {when(claim['registered_at'])} (self-declared)")
    if claim["attested"] is not None:
        parts.append(f"registered by {when(claim['attested']['at'])} (attested by {claim['attested']['by']})")
    return ", ".join(parts) or "not dated"


def _says(claim: Mapping[str, Any], form: Form) -> str:
    if claim["verdict"] == "marked":
        return (
            "A secret key that had no part in making this suspect would come this far with a probability of"
            f" {form.odds(claim['log10_false_claim'])}; this is a proven bound (Hoeffding's inequality), whatever the"
            " suspect is."
        )
    if claim["verdict"] == "inconclusive":
        if claim["would_be_claim_if_attested"]:
            return f"{_WOULD}: a key that had no part in the suspect hardly comes this far, but many tried ones may."
        if claim["derivation"]["derived"]:
            return "That the suspect is derived from your asset stands. Of the mark, neither yes nor no is said."
        return (
            f"{_nothing_of(claim)} was recognised in the suspect. That is no proof: more pictures, or more of the"
            " model, may show what these do not, and there are ways to hide a model that no search undoes."
        )
    least = surely(claim["power"]).removeprefix("more than ")
    return (
        f"That the suspect is derived from your asset stands, mark or no mark. With a probability of at least {least},"
        f" {_WOULD_SHOW}."
    )


def _does_not_say(claim: Mapping[str, Any]) -> str:
    if claim["verdict"] == "marked":
        return (
            "It does not say who published the suspect, nor that they knew of the mark; nor who was first, should"
            " somebody else's mark be in it as well: that is settled by a dispute."
        )
    if claim["verdict"] == "inconclusive":
        return "It does not say that the suspect is clean."
    return (
        "It does not acquit anybody: a mark that was cleaned, averaged or painted away is absent, too. It does not say"
        " that the suspect is lawful, nor that it is free of another copy's or owner's mark; each copy has a record of"
        " its own."
    )


def _record_time(claim: Mapping[str, Any], form: Form) -> str:
    if not claim["record_id"]:
        return "No registered model was compared, so no date of registration enters."
    said = dated(claim)
    date = f"The record is {said}"
    limit = form.power(2, -128)
    if claim["verdict"] == "marked" and claim["meets_dishonest_claimant_rate"]:
        return (
            f"{date}. The bound also meets {limit}, so no trying of keys and originals explains it. Who was first it"
            " does not say: whoever marks a stolen model has a true mark in it. Where two claim one model, a dispute"
            " settles it: whose mark is in the other's original."
        )
    if claim["verdict"] == "marked":
        return (
            f"{date}. The bound does not reach {limit}; it counts because"
            f" {BASES.get(claim['rate_basis'], 'the record is known to be older than the suspect')}."
        )
    return f"{date}; whether the suspect is older or younger is not known here."


def _angle(rotation: Any) -> float:
    """Angle of a rotation matrix, degrees."""
    trace = sum(rotation[i][i] for i in range(3))
    return math.degrees(math.acos(min(1.0, max(-1.0, (trace - 1.0) / 2.0))))
