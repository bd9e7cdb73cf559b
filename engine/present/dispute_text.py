"""A settled dispute in words, for terminal, report and API, and as one page to read, print and send."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Template

from engine.present.html_pages import templates
from engine.present.numerals import TYPOGRAPHIC, Form, number, percent, when

__all__ = ["DEEDS", "DisputeWords", "dispute_page", "dispute_words"]

PARTIES = {"a": "Party A", "b": "Party B"}
HEADLINES = {
    "a": "Party A came first",
    "b": "Party B came first",
    "both": "Inconclusive: each watermark is in the other party's original",
    "neither": "Inconclusive: neither watermark is in the other party's original",
}
DEEDS = {
    "copying": (
        "Copying: the original of {thief} equals the marked model of {owner} in every Gaussian and every color."
    ),
    "re-marking": (
        "Re-marking: {thief} marked a model that already carried the watermark of {owner}. So {thief} has a true"
        " watermark, too; it proves nothing about who was first."
    ),
    "overwriting": "Overwriting: the model of {thief} carries both watermarks, one over the other.",
    "inversion": (
        "Inversion: the watermark of {thief} is not in the model that {thief} published, and the original of {thief}"
        " carries the watermark of {owner}. This original was computed from the marked model."
    ),
    "back-dating": (
        "Back-dating: {thief} declares an earlier date. No third party attests it, and the watermarks contradict it."
    ),
    "unmarked": (
        "Neither watermark was found in the model that {party} published, which is derived from an asset of the two: it"
        " was computed from the original, or a watermark was removed from it."
    ),
    "equal originals": (
        "The two originals are equal to rounding: one party got it from the other, or computed it from several marked"
        " copies. That decides nothing by itself; see the dates."
    ),
    "same original": "Both records hold the same original: one party got it from the other.",
}
"""What was done, in words; names of the parties are filled in."""


@dataclass(frozen=True)
class DisputeWords:
    """A settled dispute in words."""

    headline: str
    finding: str
    reasons: tuple[str, ...]
    looks: tuple[tuple[str, str, str], ...]  # whose mark, where it was searched for, the result
    dates: tuple[tuple[str, str], ...]  # whose record, and when it was registered, who says so
    limits: tuple[str, ...]  # what the finding does not say


def dispute_words(found: Mapping[str, Any], form: Form = TYPOGRAPHIC) -> DisputeWords:
    """A dispute in words; `found` as of `Dispute.to_json`."""
    return DisputeWords(
        HEADLINES[found["first"]],
        _finding(found),
        tuple(_reasons(found)),
        tuple((PARTIES[one["mark_of"]], _place(one), _answer(one, form)) for one in found["looks"]),
        tuple((PARTIES[name], _date(date)) for name, date in found["dates"].items()),
        (
            "It rests on the records that the two parties brought; no other record was examined.",
            "It does not say who published which model, who had the right to, or whether a third party was first.",
        ),
    )


def dispute_page(found: Mapping[str, Any], jws: str = "") -> str:
    """One self-contained HTML page, with the signed finding (compact JWS) where there is one."""
    return _template().render(words=dispute_words(found), found=found, parties=PARTIES, jws=jws)


def _names(found: Mapping[str, Any]) -> dict[str, str]:
    first = found["first"] if found["first"] in PARTIES else "a"
    return {"owner": PARTIES[first], "thief": PARTIES["b" if first == "a" else "a"]}


def _finding(found: Mapping[str, Any]) -> str:
    if found["first"] in PARTIES:
        owner, thief = _names(found).values()
        return (
            f"The watermark of {owner} is in the original of {thief}; the watermark of {thief} is not in the original"
            f" of {owner}. So {thief} made this original from a model that {owner} had marked before."
        )
    if found["first"] == "both":
        return (
            "Each party's watermark is in the other party's original, so both originals are marked models. The"
            " watermarks do not tell who was first."
        )
    if found["same_original"]:
        return (
            "Both originals show the same asset, and neither carries the other party's watermark. Either both parties"
            " marked an unmarked model, or one removed the other's watermark. The watermarks do not tell who was first."
        )
    return "No common part of the two originals was recognized: each party may have marked a model of its own."


def _reasons(found: Mapping[str, Any]) -> list[str]:
    names = _names(found)
    reasons = [DEEDS[deed].format(**names, party=PARTIES.get(by, "")) for deed, by in found["seen"]]
    earlier = found["registered_first"]
    if not earlier:
        reasons.append("The dates do not tell who registered first, because a third party does not attest both.")
    elif found["first"] not in PARTIES:
        reasons.append(f"By the attested times, {PARTIES[earlier]} registered first.")
    elif earlier == found["first"]:
        reasons.append(f"The attested times agree: {PARTIES[earlier]} registered first.")
    else:
        reasons.append(
            f"By the attested times, {PARTIES[earlier]} registered first. But an original that carries the other"
            " party's watermark was made after this watermark, whatever the dates of registration."
        )
    return reasons


def _place(look: Mapping[str, Any]) -> str:
    kind = {"original": "the original of", "published": "the model published by"}[look["kind"]]
    return f"{kind} {PARTIES[look['place']]}"


def _answer(look: Mapping[str, Any], form: Form) -> str:
    odds = form.odds(look["log10_false_claim"])
    if look["marked"]:
        return f"found (z {number(look['z'])}, required {number(look['z_threshold'])}; false-claim probability {odds})"
    share = look["derivation"]["share"] or 0.0
    found = f"; {percent(share)} of this party's asset is in it" if look["derivation"]["derived"] and share else ""
    return f"not found (z {number(look['z'])}, required {number(look['z_threshold'])}){found}"


def _date(date: Mapping[str, str]) -> str:
    parts = [f"{when(date['self_declared'])} (self-declared)"] if date["self_declared"] else []
    if date["attested"]:
        parts.append(f"{when(date['attested'])} (attested by {date['attested_by']})")
    return ", ".join(parts) or "not dated"


@cache
def _template() -> Template:
    return templates(Path(__file__).parent).get_template("dispute.html")
