"""A claim in the words of somebody who is no engineer; honest about what it does not say."""

import math
from collections.abc import Mapping
from datetime import datetime
from typing import Any

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

VERDICTS = {"marked": "Mark found", "not_marked": "No mark", "inconclusive": "Undecided"}

ROUTES = {
    "model": "The suspect model's points, compared one by one with the registered original.",
    "render": "The suspect model seen from the owner's secret viewpoints, as a picture.",
    "image": "The pictures handed in, compared with views of the registered original.",
}


def power_of_ten(exponent: float) -> str:
    """10 to a whole power, as it is written."""
    return "10" + str(round(exponent)).translate(_SUPERSCRIPT)


def when(at: str) -> str:
    """2026-11-03T09:14:07.123456+00:00 as a person writes it."""
    time = datetime.fromisoformat(at)
    return f"{time.day} {time:%B %Y}, {time:%H:%M:%S} UTC"


def rate(probability: float) -> str:
    """A small probability in powers of ten."""
    digits, exponent = f"{probability:.1e}".split("e")
    power = power_of_ten(int(exponent))
    return power if digits == "1.0" else f"{digits} · {power}"


def bound(log10_probability: float) -> str:
    """A bound in words, rounded so that nothing is overstated."""
    if log10_probability > -1:
        share = math.ceil(100 * 10**log10_probability) / 100
        return "1: no evidence of the mark" if share == 1 else f"{share:.2f}"
    return power_of_ten(math.ceil(log10_probability - 1e-9))


def odds(log10_probability: float) -> str:
    """A bound as "1 in 10^N", rounded so that nothing is overstated."""
    exponent = math.floor(-log10_probability + 1e-9)
    return f"1 in {power_of_ten(exponent)}" if exponent >= 1 else "1 in 1"


def percent(share: float) -> str:
    """A share in percent that says 100 % only of the whole."""
    if 0.999 <= share < 1.0:
        return "more than 99.9 %"
    return f"{100.0 * share:.1f} %".replace(".0 %", " %")


def facts(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Label and value of what a reader looks for first."""
    message, verdict = document["message"], document["verdict"]
    found = []
    if verdict == "marked":
        found.append(("Chance of a false claim", f"at most {odds(document['log10_false_claim'])}"))
    elif verdict == "not_marked":
        sure = percent(min(document["evidence"][0]["power"], 0.9999))
        found.append(("Chance that a mark would be seen", sure))
    else:
        found.append(("What is missing", document["missing"]))
    if message is not None and verdict != "inconclusive":
        chance = "" if verdict == "marked" else f" (coins: {message['bits'] // 2})"
        found.append(("Bits as registered", f"{message['matching']} of {message['bits']}{chance}"))
    if document["derived_fraction"] is not None:
        found.append(("Of the registered model found", percent(document["derived_fraction"])))
    return found


def sentence(document: Mapping[str, Any]) -> str:
    """The verdict in one sentence."""
    what = "These pictures show" if document["subject"]["kind"] == "pictures" else "This model contains"
    it = "the pictures" if document["subject"]["kind"] == "pictures" else "the model"
    whose = f"the copy made for “{document['copy']}”" if document["copy"] else "the registered model"
    if document["verdict"] == "marked":
        return f"{what} {whose}, or something made from it: its hidden mark was found."
    if document["verdict"] == "inconclusive":
        return f"There is too little evidence in {it} for a yes or a no."
    if document["derived_but_unmarked"]:
        return f"The registered model, or part of it, is in {it}, but not this copy's hidden mark."
    return f"The hidden mark of {whose} is not in {it}."


def meaning(document: Mapping[str, Any]) -> dict[str, str]:
    """What the claim says, what it does not, how it was found, and what the record's date is good for."""
    return {
        "says": _says(document),
        "does_not_say": _does_not_say(document),
        "method": (
            "The comparison used the owner's sealed record, which holds the unmarked original and the secret"
            " positions of the mark; nobody can repeat it without that record and the owner's key."
        ),
        "record_time": _record_time(document),
    }


def _says(document: Mapping[str, Any]) -> str:
    if document["verdict"] == "marked":
        return (
            "A secret key that had no part in making this suspect would come this far with a probability of at"
            f" most {odds(document['log10_false_claim'])}; this is a proven bound, whatever the suspect is."
        )
    if document["verdict"] == "not_marked":
        evidence = document["evidence"][0]
        sure = percent(min(evidence["power"], 0.9999))
        if evidence["expected_z"] == 0:  # nothing to measure: what is known is how well pieces are found
            return (
                "Nothing of the registered model was found in the suspect; in measurements, a piece that is there is"
                f" found in {sure} of cases."
            )
        return (
            "Had the suspect carried this copy's mark, even worn to half its strength, it would have been seen with"
            f" a probability of at least {sure.removeprefix('more than ')}."
        )
    return "Neither yes nor no: more pictures, or more of the model, can decide it."


def _does_not_say(document: Mapping[str, Any]) -> str:
    if document["verdict"] == "marked":
        return "It does not say who published the suspect, nor that they knew of the mark."
    if document["verdict"] == "not_marked":
        return "It does not say that the suspect is lawful, nor that it is free of another copy's or owner's mark."
    return "It does not say that the suspect is clean."


def _record_time(document: Mapping[str, Any]) -> str:
    if document["registered_at"] is None:
        return "No registered model was compared, so no date of registration enters."
    logged = f"This service logged the registration on {when(document['registered_at'])}"
    if document["meets_dishonest_claimant_rate"]:
        return (
            f"{logged}; the bound also meets 2⁻¹²⁸, so it stands even against a claimant who made keys and"
            " originals to fit, and needs no trust in that date."
        )
    if document["verdict"] == "marked":
        return (
            f"{logged}; the bound does not reach 2⁻¹²⁸, so the claim counts only if the suspect is known to be"
            " younger than that date."
        )
    return f"{logged}; whether the suspect is older or younger is not known here."
