"""Whether a claim's numbers and words follow from one another."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from importlib.metadata import version
from typing import Any

from engine.watermark.claim import ClaimConfig
from engine.watermark.rates import DEMANDS, DRAWS, conditions_of, moment
from engine.watermark.statistics import CHANCE_RATE, DISHONEST_CLAIMANT_RATE, log10_false_claim_bound, z_threshold
from service.claims.document import document_words
from service.claims.schema import DRAWN_BY_STAMP, SCHEMA_VERSION


class Status(StrEnum):
    """Outcome of a check. "Could not check" is an outcome of its own."""

    PASS = "pass"
    FAIL = "fail"
    NOT_CHECKED = "not_checked"


@dataclass(frozen=True)
class Check:
    """One thing that was checked."""

    code: str  # readable, signature, schema, arithmetic, log, registration, or as `_around` says
    status: Status
    text: str


def arithmetic_fault(document: Mapping[str, Any]) -> str:
    """What does not follow in a claim's numbers; empty where all does."""
    checks = [_bound_fault, _evidence_fault]
    if document["schema_version"] > 1:
        checks += [_rate_fault, _derivation_fault]
    if document["schema_version"] >= DRAWN_BY_STAMP:
        checks += [_drawing_fault, _conditions_fault]
    return next(filter(None, (check(document) for check in (*checks, _search_fault, _message_fault))), "")


def _bound_fault(document: Mapping[str, Any]) -> str:
    """Confidence and threshold follow from the stated bound, the rate and the number of tries."""
    stated, threshold = document["log10_false_claim"], document["threshold"]
    if document["meets_dishonest_claimant_rate"] != (stated <= math.log10(DISHONEST_CLAIMANT_RATE)):
        return f"whether the bound of 10^{stated:g} is at most 2^-128 is stated wrongly"
    if not math.isclose(document["confidence"], -math.expm1(stated * math.log(10)), abs_tol=1e-12):
        return f"a confidence of {document['confidence']:g} does not follow from a bound of 10^{stated:g}"
    if threshold is not None:
        needed = z_threshold(threshold["false_claim_rate"], document["tries"])
        if not math.isclose(threshold["z"], needed, rel_tol=1e-9):
            return f"a threshold of z = {threshold['z']:g} does not follow from its rate and {document['tries']} tries"
    return ""


def _evidence_fault(document: Mapping[str, Any]) -> str:
    """Bound and verdict follow from each piece of evidence."""
    stated, threshold = document["log10_false_claim"], document["threshold"]
    for one in document["evidence"]:
        if threshold is None:
            return "evidence without a threshold"
        if not math.isclose(log10_false_claim_bound(one["z"], document["tries"]), stated, abs_tol=1e-6):
            return f"a bound of 10^{stated:g} does not follow from z = {one['z']:g} and {document['tries']} tries"
        if (one["z"] >= threshold["z"]) != (document["verdict"] == "marked"):
            return f"the verdict does not follow from z = {one['z']:g} and the threshold {threshold['z']:g}"
    return "a mark without evidence" if document["verdict"] == "marked" and not document["evidence"] else ""


def _search_fault(document: Mapping[str, Any]) -> str:
    """Whether an asset was recognised, and named, follows from the verdict and from what was searched."""
    if (searched := document.get("searched")) is not None:
        derived = document["derivation"]["derived"] or document["would_be_claim_if_attested"]
        if searched["recognised"] != (document["verdict"] == "marked" or derived):
            return "whether an asset was recognised does not follow from the verdict"
        if (document["asset"] is not None) != (searched["recognised"] or searched["scope"] == "one"):
            return "the claim names an asset that was neither requested nor recognised, or omits one that was"
    return ""


def _message_fault(document: Mapping[str, Any]) -> str:
    """The message's figures follow from one another."""
    message = document["message"]
    if message is not None:
        if len(message["reliability"]) != message["bits"]:
            return "the message does not have a reliability for each bit"
        if not math.isclose(message["bit_accuracy"], message["matching"] / message["bits"]):
            return "the bit accuracy is not the share of matching bits"
    return ""


def _rate_fault(document: Mapping[str, Any]) -> str:
    """The rate is not the claimant's choice: it follows from who says when the record was registered."""
    threshold, attested = document["threshold"], document["attested"]
    would = document["would_be_claim_if_attested"]
    if threshold is None:
        return "a claim without evidence would be none, attested or not" if would else ""
    basis, rate = threshold["basis"], threshold["false_claim_rate"]
    if basis not in DEMANDS or rate > DEMANDS[basis]:
        return f"a rate of {rate:g} does not do where the record is {basis!r}"
    if (attested is None) != (basis == "self_declared") or (basis == "drawn" and not attested["drawn"]):
        return f"the record is called {basis!r}, but what is attested says otherwise"
    enough = document["log10_false_claim"] <= math.log10(CHANCE_RATE) and document["verdict"] != "marked"
    return "a bound above 10^-9 would be no claim, attested or not" if would and not enough else ""


def _drawing_fault(document: Mapping[str, Any]) -> str:
    """A rate above 2^-128 rests on a time stamp that drew for the record, each request for one being a hypothesis:
    dates alone carried it in earlier versions."""
    threshold, attested, drawing = document["threshold"], document["attested"], document["drawing"]
    if (drawing is not None) != (attested is not None and attested["drawn"]):
        return "what is attested and the time stamp that drew for the record do not go together"
    if threshold is None or threshold["false_claim_rate"] <= DISHONEST_CLAIMANT_RATE:
        return ""
    rate, version = f"a rate of {threshold['false_claim_rate']:g}", document["schema_version"]
    if drawing is None:
        return f"{rate} needs a time stamp that drew for the record, in a claim of version {version}; there is none"
    return f"{rate} counts {DRAWS:,} requests to who drew as hypotheses" if document["tries"] % DRAWS else ""


def _conditions_fault(document: Mapping[str, Any]) -> str:
    """What the bound waits for follows from the basis of the rate, and the dates fit it."""
    stated, threshold, attested = document["conditions"], document["threshold"], document["attested"]
    if threshold is None or not document["would_be_claim_if_attested"]:
        return "conditions are named of what needs none" if stated else ""
    basis = threshold["basis"]
    date = next((each["date"] or "" for each in stated), "")
    if not stated or stated != [each.to_json() for each in conditions_of(basis, date)]:
        return f"the conditions are not those of a record that is {basis!r}"
    try:
        younger = basis != "dated" or moment(date) > moment(attested["at"])
    except ValueError:
        return f"{date!r} is no date since when a suspect is known"
    return "" if younger else f"a suspect that is known since {date} is not younger than the registration"


def _derivation_fault(document: Mapping[str, Any]) -> str:
    """`not_marked` is said only of what was found in the suspect, and near the original."""
    derivation, config = document["derivation"], ClaimConfig()
    if derivation is None or derivation["share"] != document["derived_fraction"]:
        return "the share of the asset is stated in two ways"
    if document["derived_but_unmarked"] != (document["verdict"] == "not_marked"):
        return "whether the suspect is derived, and without this mark, does not follow from the verdict"
    if document["verdict"] != "not_marked":
        return ""
    one = document["evidence"][0] if document["evidence"] else None
    if one is None or one["change"] is None:
        return "a mark is called absent without evidence"
    sure = one["power"] >= config.power and one["change"] <= config.room
    return "" if sure and derivation["derived"] else "the evidence leaves room for the mark that is called absent"


def meaning_check(document: Mapping[str, Any]) -> Check:
    """Whether the signed words follow from the signed numbers."""
    made_by = document["tool"]["version"]
    if document["schema_version"] != SCHEMA_VERSION or made_by != version("mark3dgs"):
        text = f"The meaning is in the words of version {made_by}; this version cannot check them."
        return Check("meaning", Status.NOT_CHECKED, text)
    if document_words(document).meaning == document["meaning"]:
        return Check("meaning", Status.PASS, "The words follow from the numbers.")
    return Check("meaning", Status.FAIL, "the signed words do not follow from the signed numbers")
