"""A claim in words: the one wording of it, for command line, report, API and page.

Said of the plain JSON of `verify --json`. Nothing is overstated: bounds are rounded against the claim, and nothing
measured is called certain.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from engine.watermark.statistics import DISHONEST_CLAIMANT_RATE

HEADLINES = {"marked": "Mark found", "not_marked": "No mark", "inconclusive": "Undecided"}

ROUTES = {
    "model": "the suspect's Gaussians, compared one by one with the registered original",
    "render": "the suspect model seen at the owner's secret views, as a black box",
    "image": "the pictures, compared with renders of the registered original",
}

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_CERTAIN = 0.9999
"""No measured probability is said to be larger."""


@dataclass(frozen=True)
class Form:
    """How powers and names are written: the one difference between words in a terminal and words on a page."""

    raised: bool

    def power(self, base: int, exponent: int) -> str:
        """10^-9, or with the exponent raised."""
        return f"{base}{str(exponent).translate(_RAISED)}" if self.raised else f"{base}^{exponent}"

    def name(self, text: str) -> str:
        """A name that somebody gave, in quotes."""
        return f"“{text}”" if self.raised else repr(text)

    def odds(self, log10_probability: float) -> str:
        """A bound on a probability as "at most 1 in 10^N", rounded so that nothing is overstated."""
        exponent = math.floor(-log10_probability + 1e-9)
        if exponent >= 1:
            return f"at most 1 in {self.power(10, exponent)}"
        hundredths = math.ceil(100.0 * 10.0**log10_probability)
        return f"at most {hundredths} in 100" if hundredths < 100 else "no better than chance"

    def rate(self, probability: float) -> str:
        """A small probability that somebody chose: "1 in 10^9"."""
        digits, exponent = f"{probability:.1e}".split("e")
        return f"{digits.removesuffix('.0')} in {self.power(10, -int(exponent))}"


PLAIN, TYPOGRAPHIC = Form(raised=False), Form(raised=True)


def percent(share: float) -> str:
    """A share in percent that says 100 % only of the whole."""
    if 0.999 <= share < 1.0:
        return "more than 99.9 %"
    return f"{100.0 * share:.1f} %".replace(".0 %", " %")


def surely(probability: float) -> str:
    """A probability in percent; nothing measured is ever certain."""
    return percent(min(probability, _CERTAIN))


def when(at: str) -> str:
    """2026-11-03T09:14:07.123456+00:00 as a person writes it; what is no such time stays as it is."""
    try:
        time = datetime.fromisoformat(at)
    except ValueError:
        return at
    return f"{time.day} {time:%B %Y}, {time:%H:%M:%S} UTC"


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
    limits: tuple[tuple[float, str], ...]  # what a bound is held against: the rate that was asked for, and 2^-128


def words_of(
    claim: Mapping[str, Any], form: Form, *, suspect: str = "", pictures: int = 0, logged: bool = False
) -> Words:
    """A claim in words.

    Parameters
    ----------
    claim : mapping
        Keys of `verify --json`; `message` is None and `record_id` empty where nothing could be compared.
    suspect : str
        Its name; left out, it is "this model" or "these pictures".
    pictures : int
        How many were looked at; 0 for a model.
    logged : bool
        `registered_at` is the word of an audit log, not of the record alone.
    """
    against = [(math.log10(DISHONEST_CLAIMANT_RATE), f"even against forgers: 1 in {form.power(2, 128)}")]
    if (asked := claim["false_claim_rate"]) is not None:
        against.insert(0, (math.log10(asked), f"asked for: {form.rate(asked)}"))
    return Words(
        headline=HEADLINES[claim["verdict"]],
        finding=_finding(claim, form, suspect, pictures),
        facts=tuple(sorted(_facts(claim, form), key=lambda fact: not fact.leading)),
        meaning={
            "says": _says(claim, form),
            "does_not_say": _does_not_say(claim),
            "method": (
                "The comparison used the owner's sealed record, which holds the unmarked original and the secret"
                " positions of the mark; nobody can repeat it without that record and the owner's key."
            ),
            "record_time": _record_time(claim, form, logged),
        },
        limits=tuple(against),
    )


def _finding(claim: Mapping[str, Any], form: Form, suspect: str, pictures: int) -> str:
    kind = {0: "model", 1: "picture"}.get(pictures, "pictures")
    it = suspect or f"the {kind}"
    if claim["verdict"] == "inconclusive":
        return f"There is too little evidence in {it} for a yes or a no."
    if claim["derived_but_unmarked"]:
        return f"The registered model, or part of it, is in {it}, but not this copy's hidden mark."
    whose = f"the copy made for {form.name(claim['copy'])}" if claim["copy"] else "the registered model"
    if claim["verdict"] == "not_marked":
        return f"The hidden mark of {whose} is not in {it}."
    this = suspect or f"{'These' if pictures > 1 else 'This'} {kind}"
    shows = {0: "contains", 1: "shows"}.get(pictures, "show")
    return f"{this} {shows} {whose}, or something made from it: its hidden mark was found."


def _facts(claim: Mapping[str, Any], form: Form) -> list[Fact]:
    found = []
    if claim["message"] is not None:
        tried = f"{claim['tries']} {'try' if claim['tries'] == 1 else 'tries'} counted"
        odds, asked = form.odds(claim["log10_false_claim"]), form.rate(claim["false_claim_rate"])
        found.append(Fact("false claim", f"{odds}, {tried} (asked for: {asked})", leading=True))
        bits = f"{claim['message']}: {claim['matching_bits']} of {claim['bits']} bits as registered"
        found.append(Fact("message read", f"{bits}, {_sureness(claim)}", leading=True))
    if claim["verdict"] == "not_marked" and claim["power"] > 0:
        found.append(Fact("missed mark", f"{surely(claim['power'])} sure that {_would_show(claim)}", leading=True))
    if claim["missing"]:
        found.append(Fact("missing", claim["missing"], leading=True))
    if claim["derived_fraction"] is not None:
        text = f"{percent(claim['derived_fraction'])} of the registered model was found in the suspect"
        found.append(Fact("share of asset", text, leading=True))
    if claim["transform"] is not None and "scale" in claim["transform"]:
        turn, scale = _angle(claim["transform"]["rotation"]), 1.0 / claim["transform"]["scale"]
        first = "mirrored, then " if claim["transform"].get("mirrored") else ""
        found.append(Fact("moved", f"{first}turned by {turn:.1f} degrees and scaled by {scale:.4g}"))
    if claim["route"]:
        found.append(Fact("evidence", ROUTES.get(claim["route"], claim["route"])))
    if claim["copy"]:
        found.append(Fact("copy", f"the one made for {form.name(claim['copy'])}"))
    if claim["record_id"]:
        key = f" of key {claim['owner']}" if claim.get("owner") else ""
        dated = f"registered {when(claim['registered_at'])}" if claim["registered_at"] else "not dated"
        found.append(Fact("record", f"{claim['record_id']}{key}, {dated}"))
    return found + [Fact("note", note) for note in claim["notes"]]


def _sureness(claim: Mapping[str, Any]) -> str:
    if claim["verdict"] != "marked":
        return f"where coins would give about {claim['bits'] // 2}"
    return f"the weakest {surely(min(claim['bit_reliability']))} sure"


def _would_show(claim: Mapping[str, Any]) -> str:
    if claim["expected_z"] == 0:  # nothing to measure: what is known is how well pieces are found
        return "a piece of the registered model, were it there, would have been found"
    return "this copy's mark, had it been there, would have been seen, even worn to half its strength"


def _says(claim: Mapping[str, Any], form: Form) -> str:
    if claim["verdict"] == "marked":
        return (
            "A secret key that had no part in making this suspect would come this far with a probability of"
            f" {form.odds(claim['log10_false_claim'])}; this is a proven bound (Hoeffding's inequality), whatever the"
            " suspect is."
        )
    if claim["verdict"] == "inconclusive":
        return "Neither yes nor no: more pictures, or more of the model, can decide it."
    least = surely(claim["power"]).removeprefix("more than ")
    return f"With a probability of at least {least}, {_would_show(claim)}."


def _does_not_say(claim: Mapping[str, Any]) -> str:
    if claim["verdict"] == "marked":
        return "It does not say who published the suspect, nor that they knew of the mark."
    if claim["verdict"] == "inconclusive":
        return "It does not say that the suspect is clean."
    return "It does not say that the suspect is lawful, nor that it is free of another copy's or owner's mark. " + (
        "Part of this asset is in it, unmarked: compare it with the original."
        if claim["derived_but_unmarked"]
        else "Each copy has a record of its own."
    )


def _record_time(claim: Mapping[str, Any], form: Form, logged: bool) -> str:
    if not claim["record_id"]:
        return "No registered model was compared, so no date of registration enters."
    if claim["registered_at"]:
        date = when(claim["registered_at"])
        dated = f"This service logged the registration on {date}" if logged else f"The record is dated {date}"
    else:
        dated = "The record is not dated"
    limit = form.power(2, -128)
    if claim["meets_dishonest_claimant_rate"]:
        return (
            f"{dated}; the bound also meets {limit}, so it stands even against a claimant who made keys and originals"
            " to fit, and needs no trust in a date."
        )
    if claim["verdict"] == "marked":
        return (
            f"{dated}; the bound does not reach {limit}, so the claim counts only if the record is known to be older"
            " than the suspect."
        )
    return f"{dated}; whether the suspect is older or younger is not known here."


def _angle(rotation: Any) -> float:
    """Angle of a rotation matrix, degrees."""
    trace = sum(rotation[i][i] for i in range(3))
    return math.degrees(math.acos(min(1.0, max(-1.0, (trace - 1.0) / 2.0))))
