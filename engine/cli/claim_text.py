"""A claim in words: what was found, how sure it is, and what it does not mean."""

import math
import textwrap
from collections.abc import Mapping
from typing import Any

WIDTH = 96
_LABEL = 16

ROUTES = {
    "model": "the suspect's Gaussians, compared one by one with the registered reference",
    "render": "the suspect model seen at the owner's secret views, as a black box",
    "image": "the pictures, compared with renders of the registered reference",
}

HEADLINES = {"marked": "MARKED", "not_marked": "NOT MARKED", "inconclusive": "INCONCLUSIVE"}


def odds(log10_probability: float) -> str:
    """A bound as "at most 1 in 10^N", N rounded down so that nothing is overstated."""
    exponent = math.floor(-log10_probability + 1e-9)
    return f"at most 1 in 10^{exponent}" if exponent >= 1 else "no better than chance"


def percent(share: float) -> str:
    """A share in percent that says 100 % only of the whole."""
    if 0.999 <= share < 1.0:
        return "more than 99.9 %"
    return f"{100.0 * share:.1f} %".replace("100.0 %", "100 %")


def surely(probability: float) -> str:
    """A probability in percent; nothing measured is ever certain."""
    return percent(min(probability, 0.9999))


def headline(report: Mapping[str, Any], suspect: str) -> str:
    """The verdict in one sentence."""
    if report["verdict"] == "marked":
        text = f"the mark of this record is in {suspect}."
    elif report["verdict"] == "inconclusive":
        text = f"too little evidence in {suspect} for a yes or a no."
    elif report["derived_but_unmarked"]:
        text = f"this asset is in {suspect}, but not this mark."
    else:
        text = f"the mark of this record is not in {suspect}."
    return f"{HEADLINES[report['verdict']]}: {text}"


def facts(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Label and text of what was found, in the order a reader needs it.

    Parameters
    ----------
    report : mapping
        Keys of `verify --json`.
    """
    asked = odds(math.log10(report["false_claim_rate"]))
    bits = f"{report['matching_bits']} of {report['bits']} bits as registered"
    found = [
        ("message read", f"{report['message']}: {bits}, {_sureness(report)}"),
        ("false claim", f"{odds(report['log10_false_claim'])} (asked for: {asked})"),
    ]
    if report["verdict"] == "not_marked" and report["power"] > 0:
        sure = surely(report["power"])
        found.append(("missed mark", f"even a mark of half the strength would have shown: {sure} sure"))
    if report["missing"]:
        found.append(("missing", report["missing"]))
    if report["derived_fraction"] is not None:
        text = f"{percent(report['derived_fraction'])} of the registered model was found in the suspect"
        found.append(("share of asset", text))
    if report["transform"] is not None and "scale" in report["transform"]:
        turn, scale = _angle(report["transform"]["rotation"]), 1.0 / report["transform"]["scale"]
        found.append(("moved", f"turned by {turn:.1f} degrees and scaled by {scale:.4g}"))
    found.append(("evidence", ROUTES.get(report["route"], report["route"])))
    if report["copy"]:
        found.append(("copy", f"the one made for {report['copy']!r}"))
    if report.get("record_id"):
        when = f"registered {report['registered_at']}" if report["registered_at"] else "not dated"
        found.append(("record", f"{report['record_id']} of key {report['owner']}, {when}"))
    return found + [("note", note) for note in report["notes"]]


def meaning(report: Mapping[str, Any]) -> tuple[str, str]:
    """What the verdict means, and what it does not."""
    if report["verdict"] == "marked":
        chance = odds(report["log10_false_claim"])
        says = (
            f"It means that a key with no part in making this suspect would come this far in {chance}"
            " cases. That is a proven bound (Hoeffding's inequality), whatever the suspect is. It was found"
            " with the owner's record, which holds the unmarked original."
        )
        not_says = "It does not mean that whoever published the suspect made it, or knew of the mark." + (
            " The bound also meets 2^-128, so it stands even where the date of the record is disputed."
            if report["meets_dishonest_claimant_rate"]
            else " The bound does not reach 2^-128: it counts only if the record is known to be older than the suspect."
        )
    elif report["verdict"] == "not_marked":
        says = "It means that, had this suspect carried this copy's mark, the evidence would have shown it."
        not_says = "It does not mean that the suspect is lawful, or free of the mark of another copy or owner. " + (
            "Part of this asset is in it, unmarked: compare it with the original."
            if report["derived_but_unmarked"]
            else "Each copy has a record of its own."
        )
    else:
        says = "It means neither yes nor no. More pictures, or more of the model, can decide it."
        not_says = "It does not mean that the suspect is clean."
    return says, not_says


def claim_lines(report: Mapping[str, Any], suspect: str) -> list[str]:
    """The whole claim as lines of at most WIDTH characters."""
    lines = [headline(report, suspect), ""]
    for label, text in facts(report):
        lines += textwrap.wrap(text, WIDTH, initial_indent=f"  {label:<{_LABEL}}", subsequent_indent=" " * (_LABEL + 2))
    for text in meaning(report):
        lines += ["", *textwrap.wrap(text, WIDTH)]
    return lines


def _sureness(report: Mapping[str, Any]) -> str:
    if report["verdict"] != "marked":
        return f"where coins would give about {report['bits'] // 2}"
    return f"the weakest {surely(min(report['bit_reliability']))} sure"


def _angle(rotation: Any) -> float:
    """Angle of a rotation matrix, degrees."""
    trace = sum(rotation[i][i] for i in range(3))
    return math.degrees(math.acos(min(1.0, max(-1.0, (trace - 1.0) / 2.0))))
