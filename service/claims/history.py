"""Whether claims are of one log: what is proven of its beginning, within a claim and from one claim to another."""

from collections.abc import Mapping, Sequence
from typing import Any

from engine.records.merkle import check_consistency
from engine.records.signatures import SignatureFault, verify
from service.claims.arithmetic import Check, Status
from service.claims.carriers import UnreadableError, strict_json, unpack
from service.claims.schema import ClaimDocument

Roots = dict[int, str]
"""Root of the log, hex, by how many entries it had."""


def history_fault(audit: Mapping[str, Any]) -> str:
    """What is wrong with the earlier logs that a claim names."""
    for each in audit["earlier"]:
        try:
            proof = [bytes.fromhex(step) for step in each["proof"]]
            roots = bytes.fromhex(each["root"]), bytes.fromhex(audit["root"])
        except ValueError:
            return "a consistency proof cannot be read"
        if not check_consistency(each["size"], roots[0], audit["size"], proof, roots[1]):
            return f"the log does not begin as it was when it had {each['size']} entries"
    return ""


def against_others(document: Mapping[str, Any], others: Sequence[bytes], jwks: Mapping[str, Any]) -> list[Check]:
    """One check for each other claim: that its log is this one, earlier or later. Proofs lead from claim to claim."""
    known = _roots(document)
    left: dict[int, tuple[str, Roots]] = {}
    found: dict[int, Check] = {}
    for number, data in enumerate(others):
        try:
            other = strict_json(verify(unpack(data).jws, jwks)[0])
            ClaimDocument.model_validate(other)
            left[number] = other["claim_id"], _roots(other)
        except (UnreadableError, SignatureFault, ValueError, KeyError, TypeError) as error:
            text = f"file {number + 1} is no claim signed by these keys: {error}"
            found[number] = Check("other claim", Status.FAIL, text)
    while joined := [number for number, (_, roots) in left.items() if known.keys() & roots.keys()]:
        for number in joined:
            name, roots = left.pop(number)
            odd = sorted(size for size in known.keys() & roots.keys() if known[size] != roots[size])
            if odd:
                text = f"{name} is of another log: when it had {odd[0]} entries the two differed"
                found[number] = Check("other claim", Status.FAIL, text)
            else:
                found[number] = Check("other claim", Status.PASS, f"{name} is of the same log.")
                known |= roots
    for number, (name, _) in left.items():
        text = f"no proof leads from the log of {name} to this one: give the claims between them, too"
        found[number] = Check("other claim", Status.NOT_CHECKED, text)
    return [found[number] for number in sorted(found)]


def _roots(document: Mapping[str, Any]) -> Roots:
    """What a claim proves of its log; nothing where its own proofs do not hold."""
    audit = document["audit"]
    earlier = audit.get("earlier", []) if not history_fault({"earlier": [], **audit}) else []
    return {audit["size"]: audit["root"], **{each["size"]: each["root"] for each in earlier}}
