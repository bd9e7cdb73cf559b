"""A claim in words: the one wording of it, for command line, report, API and page.

Made from the plain JSON of `verify --json`. Nothing is overstated: bounds are rounded against the claim, and nothing
measured is called certain.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from engine.present.numerals import Form, number, percent, surely, when
from engine.watermark.claim import SCATTERED
from engine.watermark.rates import BASES, conditions_of
from engine.watermark.statistics import CHANCE_RATE, DISHONEST_CLAIMANT_RATE

HEADLINES = {"marked": "Watermark found", "not_marked": "Your unmarked original", "inconclusive": "Inconclusive"}

TO_ROUNDING = 1e-3
"""Median displacement, in sizes of a Gaussian, below which positions are called equal: formats round by more."""

COIN = 0.5 + 1e-9
"""A bit that is read no more surely than this was not read."""

ROUTES = {
    "model": "the suspect's Gaussians, compared one by one with the registered original",
    "both": "the suspect's Gaussians, compared one by one, plus its renders at the owner's secret views",
    "render": "renders of the suspect at the owner's secret views (its Gaussians were not needed)",
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
    rate = claim["false_claim_rate"]
    drawn = rate is not None and rate != DISHONEST_CLAIMANT_RATE
    named = "without a time stamp" if drawn else "required"
    against = [(math.log10(DISHONEST_CLAIMANT_RATE), f"{named}: 1 in {form.power(2, 128)}")]
    if drawn:
        against.append((math.log10(rate), f"required here: {form.rate(rate)}"))
        against.sort(reverse=True)
    return Words(
        headline=headline_of(claim),
        finding=_finding(claim, form, suspect, pictures),
        facts=tuple(sorted(_facts(claim, form), key=lambda fact: not fact.leading)),
        meaning={
            "says": _says(claim, form),
            "does_not_say": _does_not_say(claim),
            "method": (
                "The check used the owner's sealed record, which holds the unmarked original and the secret layout of"
                " the watermark (informed detection). Repeating it takes this record and the owner's key."
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
        equals = "equal" if pictures > 1 and not suspect else "equals"
        return f"{this} {equals} your unmarked original, or a part of it; your watermark was not detected. {_COMPUTED}."
    if claim["verdict"] == "inconclusive":
        it = suspect or f"the {kind}"
        if claim["would_be_claim_if_attested"]:
            return f"{_would(claim, form)}." + (f" {derived}." if claim["derivation"]["derived"] else "")
        if claim["derivation"]["derived"]:
            return f"{derived}. The evidence is not sufficient to say whether it carries the registered watermark."
        return f"{_nothing_of(claim)} was recognized in {it}."
    named = named_copy(claim)
    whose = f"the copy made for {form.name(named)}" if named else "your registered model"
    shows = {0: "contains", 1: "shows"}.get(pictures, "show")
    return f"{this} {shows} {whose}, or something made from it: its watermark was found."


def headline_of(claim: Mapping[str, Any]) -> str:
    """The verdict in two or three words."""
    return HEADLINES[claim["verdict"]] if recognizes(claim) else "Not recognized"


def recognizes(claim: Mapping[str, Any]) -> bool:
    """Whether anything of the registered model was found in the suspect, or of its mark."""
    return bool(
        claim["verdict"] != "inconclusive" or claim["derivation"]["derived"] or claim["would_be_claim_if_attested"]
    )


def named_copy(claim: Mapping[str, Any]) -> str:
    """Recipient of the copy that the watermark names; empty where it names none, as without a mark.

    Records of formats 1 and 2 name a copy by the claim itself."""
    named = claim["verdict"] == "marked" and claim.get("copy_named") is not False
    return (claim["copy"] or "") if named else ""


def why_no_bits(claim: Mapping[str, Any]) -> str | None:
    """Why a claim has no bits; None where some were read."""
    searched = claim.get("searched") or {"compared": 0, "unreadable": 0}
    if claim["message"] is None and searched["compared"] == searched["unreadable"]:
        return "no record could be compared with the suspect"
    if claim["message"] is None or not recognizes(claim):
        return "nothing of a registered model was recognized in the suspect"
    known = max(claim["bit_reliability"]) > COIN
    return None if known else "the asset was recognized, but no bit could be read"


def _nothing_of(claim: Mapping[str, Any]) -> str:
    """What was not found: the one asset that was named, or one of all."""
    if not (searched := claim.get("searched")) or searched["scope"] == "one":
        return "Nothing of your asset"
    if searched["assets"] == 1:
        return "Nothing of your registered asset"
    return f"None of your {searched['assets']} registered assets"


_COMPUTED = "Either it was never marked, or it was computed from one or more marked copies"


def _would(claim: Mapping[str, Any], form: Form) -> str:
    """Under what condition it would be a claim, and at which rate."""
    known = claim.get("conditions") or [each.text for each in conditions_of("self_declared")]
    conditions = [each if isinstance(each, str) else each["text"] for each in known]  # earlier ones are sentences
    return f"This would be a claim at {form.rate(CHANCE_RATE)} if {' and '.join(conditions)}"


def _facts(claim: Mapping[str, Any], form: Form) -> list[Fact]:
    found = []
    if claim["message"] is not None:
        tried = f"corrected for {claim['tries']:,} {'hypothesis' if claim['tries'] == 1 else 'hypotheses'}"
        odds, needed = form.odds(claim["log10_false_claim"]), _needed(claim, form)
        found.append(Fact("false claim", f"{odds} (z {number(claim['z'])}), {tried}; required: {needed}", leading=True))
        bits = f"{claim['message']}: {claim['matching_bits']}/{claim['bits']} bits match; {_sureness(claim)}"
        none = why_no_bits(claim)
        found.append(Fact("message read", f"none: {none}" if none else bits, leading=True))
    found.append(Fact("derived", derivation_text(claim["derivation"]), leading=True))
    if claim["verdict"] == "not_marked":
        found.append(Fact("difference", _change(claim.get("change")), leading=True))
        found.append(Fact("detection power", _power(claim["power"]), leading=True))
    if claim["missing"]:
        found.append(Fact("missing", claim["missing"], leading=True))
    if claim["transform"] is not None and "scale" in claim["transform"]:
        found.append(Fact("moved", _moved(claim["transform"])))
    if claim["route"]:
        found.append(Fact("evidence", ROUTES.get(claim["route"], claim["route"])))
    if layers := claim.get("layers"):
        grain = f", geometry z {layers['grain']:.1f}" if "grain" in layers else ""
        scattered = [z for name, z in layers.items() if name.endswith(SCATTERED)]
        other = f", weighted by scatter z {max(scattered):.1f}" if scattered else ""
        found.append(Fact("layers", f"color z {layers['tint']:.1f}{grain}, combined z {layers['both']:.1f}{other}"))
    if claim["copy"]:
        found.append(Fact("copy", _copy(claim, form)))
    if claim["record_id"]:
        key = f" of key {claim['owner']}" if claim.get("owner") else ""
        found.append(Fact("record", f"{claim['record_id']}{key}, {dated(claim)}"))
    if claim["rate_basis"]:
        found.append(Fact("rate", f"{_needed(claim, form)}: {BASES[claim['rate_basis']]}"))
    return found + [Fact("note", note) for note in claim["notes"]]


def _copy(claim: Mapping[str, Any], form: Form) -> str:
    """Whose copy the record is of, and whether the suspect is that one."""
    made = f"made for {form.name(claim['copy'])}"
    if claim["verdict"] != "marked":
        return f"the record is of the copy {made}; no copy is named"
    if claim.get("copy_named") is None:
        return f"the record is of the copy {made}"
    if claim["copy_named"]:
        return f"{made} (z {number(claim['copy_z'])})"
    return f"not shown to be the copy {made} (z {number(claim['copy_z'])}); tracing tests all copies"


def _change(change: float | None) -> str:
    """How far a suspect lies from the unmarked original, in sizes of what the watermark would have changed."""
    return "not measured" if change is None else f"{percent(change)} of what the watermark would change"


def _sureness(claim: Mapping[str, Any]) -> str:
    if claim["verdict"] != "marked":
        return f"pure chance gives about {claim['bits'] // 2}"
    return f"lowest bit confidence {surely(min(claim['bit_reliability']))}"


def _power(power: float) -> str:
    least = surely(power) if surely(power).startswith("more") else f"at least {surely(power)}"
    return (
        "if the watermark were there, even at half strength, it would have been found with a probability of"
        f" {least} (deliberate removal aside)"
    )


def _moved(transform: Mapping[str, Any]) -> str:
    turn, scale = _angle(transform["rotation"]), 1.0 / transform["scale"]
    parts = ["mirrored"] if transform.get("mirrored") else []
    if turn >= 0.05:
        parts.append(f"rotated by {turn:.1f} degrees")
    if abs(scale - 1.0) >= 5e-4:
        parts.append(f"scaled by {number(scale, 4)}")
    return ", ".join(parts) or "not rotated, not scaled"


def _needed(claim: Mapping[str, Any], form: Form) -> str:
    rate = claim["false_claim_rate"]
    return f"1 in {form.power(2, 128)}" if rate == DISHONEST_CLAIMANT_RATE else form.rate(rate)


def derivation_text(derivation: Mapping[str, Any]) -> str:
    """How much of the asset is in the suspect, how exactly and where."""
    if (views := derivation["views"]) is not None:
        shown, of = views
        return f"{shown} of {of} pictures show your asset" if shown else "no picture was recognized"
    share = derivation["share"]
    if not derivation["derived"]:
        return f"not established: {percent(share)} of your asset was found" if share else "not established"
    if share is None:
        return "the suspect looks like your asset from several sides, although its Gaussians are different"
    text = f"{percent(share)} of your asset was found"
    if (count := derivation["gaussians"]) is not None:
        text += f" ({count:,} Gaussians)"
    if (gap := derivation["exactness"]) is not None:
        text += (
            ", positions equal to rounding"
            if gap < TO_ROUNDING
            else f", median displacement {number(gap, 2)} of a Gaussian's size"
        )
    if (where := derivation["where"]) is not None:
        low, high = (", ".join(map(number, corner)) for corner in where)
        text += f", in the box from ({low}) to ({high})"
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
            f"The probability that an unrelated key scores this high is {form.odds(claim['log10_false_claim'])}. This"
            " is a proven bound (Hoeffding's inequality); it holds for every suspect."
        )
    if claim["verdict"] == "inconclusive":
        if claim["would_be_claim_if_attested"]:
            return (
                f"{_would(claim, form)}. One unrelated key hardly scores this high, but the best of very many keys may."
            )
        if claim["derivation"]["derived"]:
            return "The suspect is derived from your asset. Whether it carries the watermark remains open."
        return (
            f"{_nothing_of(claim)} was recognized in the suspect. This is no proof of the opposite: more pictures, or"
            " more of the model, may show it, and some ways to hide a model defeat every search."
        )
    return f"The suspect equals your unmarked original, or a part of it. In addition, {_power(claim['power'])}."


def _does_not_say(claim: Mapping[str, Any]) -> str:
    if claim["verdict"] == "marked":
        return (
            "It does not say who published the suspect, nor that they knew of the watermark. It does not say who was"
            " first if another party's watermark is in it as well: a dispute settles that."
        )
    if claim["verdict"] == "inconclusive":
        return "It does not say that the suspect carries no watermark."
    return (
        "It does not acquit anyone: a model computed from marked copies looks like this, too. It does not say how the"
        " suspect was obtained, nor that it is free of another owner's watermark."
    )


def _record_time(claim: Mapping[str, Any], form: Form) -> str:
    if not claim["record_id"]:
        return "No registered model was compared, so no registration date applies."
    said = dated(claim)
    date = f"The record is {said}"
    limit = form.power(2, -128)
    if claim["verdict"] == "marked" and claim["meets_dishonest_claimant_rate"]:
        return (
            f"{date}. The bound also meets {limit}, so a search through many keys and originals cannot explain the"
            " result. It does not say who was first: a thief who marks a stolen model has a true watermark in it. If"
            " two parties claim one model, a dispute looks for each watermark in the other party's original."
        )
    if claim["verdict"] == "marked":
        return (
            f"{date}. The bound does not reach {limit}. It is enough because"
            f" {BASES.get(claim['rate_basis'], 'the record is known to be older than the suspect')}."
        )
    return f"{date}. Whether the suspect is older or younger is not known here."


def _angle(rotation: Any) -> float:
    """Angle of a rotation matrix, degrees."""
    trace = sum(rotation[i][i] for i in range(3))
    return math.degrees(math.acos(min(1.0, max(-1.0, (trace - 1.0) / 2.0))))
