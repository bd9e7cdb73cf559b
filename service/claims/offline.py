"""Checking a claim with nothing but the service's public keys: no database, no network.

1. Find the signed claim in the file.          5. The claim is under the log's root.
2. The signature, by one of the given keys.    6. So are the asset's registration and earlier logs.
3. The document's form.                        7. What was drawn for the record follows from a time stamp.
4. Its numbers and words follow from others.   8. What stands around the claim says what was signed.
                                               9. The time stamp, if there is one.
10. Where the suspect comes from, as far as it is stated.

What is proven of the beginning of the log also shows whether several claims are of one log.
"""

import base64
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from cryptography import x509
from pydantic import ValidationError

from engine.flows.records.draw import Draw
from engine.records.merkle import check_consistency, check_inclusion, leaf_hash
from engine.records.signatures import SignatureFault, verify
from engine.records.timestamps import TimestampFault, authority_of, check_stamp, drawn_from, qualification, stamped_at
from service.claims.arithmetic import Check, Status, arithmetic_fault, meaning_check
from service.claims.carriers import Carried, UnreadableError, strict_json, unpack
from service.claims.document import summary_of
from service.claims.report import report_html
from service.claims.schema import SCHEMA_VERSION, ClaimDocument, Document
from service.trust.canonical import canonical, digest
from service.trust.commitments import ACQUISITION_MADE, ASSET_REGISTERED, CLAIM_ISSUED, acquisition_facts, claim_digest

UNTRUSTED = "no trusted certificate was given"
Certificates = Sequence[x509.Certificate]


@dataclass(frozen=True)
class Findings:
    """What is known of a file after checking it."""

    checks: tuple[Check, ...]  # in order; after a failure that leaves nothing to go by, no more are made
    document: Document | None = None  # what is signed; None unless the signature and the form hold
    signed_by: str = ""  # id of the key

    @property
    def valid(self) -> bool:
        """Whether nothing failed."""
        return all(check.status is not Status.FAIL for check in self.checks)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"valid": self.valid, **asdict(self)}


def verify_report(
    data: bytes,
    jwks: Mapping[str, Any],
    tsa_certificates: Certificates = (),
    others: Sequence[bytes] = (),
    listed: Certificates = (),
) -> Findings:
    """Check a signed claim, a claim as JSON, or a report, by the keys that are trusted to sign claims, and the
    certificates that are trusted to vouch for a time-stamping service; and whether `others` are of the same log.

    Certificates `listed` on a trusted list (eIDAS) tell qualified time stamps from plain ones.
    """
    checks: list[Check] = []

    def say(code: str, fault: str, good: str) -> bool:
        checks.append(Check(code, Status.FAIL if fault else Status.PASS, fault or good))
        return not fault

    try:  # 1
        carried = unpack(data)
    except UnreadableError as error:
        say("readable", str(error), "")
        return Findings(tuple(checks))
    try:  # 2
        payload, kid = verify(carried.jws, jwks)
    except SignatureFault as error:
        say("signature", str(error), "")
        return Findings(tuple(checks))
    say("signature", "", f"Signed by the key {kid}, one of the given keys.")
    document, fault = _read(payload)  # 3
    if not say("schema", fault, "The document has the expected form.") or document is None:
        return Findings(tuple(checks), None, kid)
    if say("arithmetic", arithmetic_fault(document), "Bound, verdict and bits follow from the stated evidence."):  # 4
        checks.append(meaning_check(document))
    audit = document["audit"]
    where = f"entry {audit['index']} of the log of {audit['size']} entries"
    say("log", _log_fault(document), f"The claim is {where} (inclusion proof).")  # 5
    if document["asset"] is not None:  # 6
        good = f"The asset was registered earlier in the same log, on {document['registered_at']}."
        say("registration", _registration_fault(document), good)
    if earlier := audit.get("earlier"):
        sizes = " and ".join(str(each["size"]) for each in earlier)
        say("history", history_fault(audit), f"The log is consistent with its state at {sizes} entries.")
    checks += against_others(document, others, jwks)
    if document.get("drawing") is not None:  # 7
        checks.append(_drawing(document, tsa_certificates, listed))
    if document.get("acquisition") is not None or audit.get("acquisition") is not None:  # 10
        checks.append(_acquisition(document, tsa_certificates, listed))
    checks += _around(data, carried, document, payload)  # 8
    if carried.timestamp is not None:  # 9
        checks.append(_stamp(carried.timestamp, carried.jws, tsa_certificates, listed))
    return Findings(tuple(checks), document, kid)


def _read(payload: bytes) -> tuple[Document | None, str]:
    """The document, or what is wrong with it."""
    try:
        document = strict_json(payload)
        version = document["schema_version"]
        if isinstance(version, int) and version > SCHEMA_VERSION:
            return None, f"a later version of this program wrote this claim (schema {version}); use that one"
        ClaimDocument.model_validate(document)
        if document["audit"] is None:
            return None, "the document does not say where it stands in the audit log"
        return (document, "") if canonical(document) == payload else (None, "the document is not in canonical form")
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(str(step) for step in first["loc"])
        return None, f"the document has another form: {place}: {first['msg']}"
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        return None, f"the document cannot be read: {error}"


def _log_fault(document: Mapping[str, Any]) -> str:
    audit, entry = document["audit"], document["audit"]["entry"]
    expected = {
        "index": audit["index"],
        "event": CLAIM_ISSUED,
        "subject": document["claim_id"],
        "payload": {"asset": document["asset"], "digest": claim_digest(document)},
    }
    for name, value in expected.items():
        if entry[name] != value:
            return f"the log's entry is of another claim (its {name} differs)"
    return "" if _included(entry, audit["proof"], audit) else "the inclusion proof does not lead to the log's root"


def _registration_fault(document: Mapping[str, Any]) -> str:
    audit, found = document["audit"], document["audit"]["registration"]
    first = audit.get("first_registration")
    if found is None or document["original"] is None:
        return "the claim names an asset, but not its registration"
    if first is None and document["schema_version"] > 1:
        return "the claim does not prove when its original was first registered"
    entry = found["entry"]
    facts = {"original_sha256": document["original"]["sha256"], "record_id": document["record_id"]}
    same = (
        entry["event"] == ASSET_REGISTERED
        and entry["subject"] == document["asset"]
        and entry["tenant"] == audit["entry"]["tenant"]
        and entry["at"] == document["registered_at"]
        and all(entry["payload"].get(name) == value for name, value in facts.items())
    )
    if not same:
        return "the log registered another asset, or at another time"
    if entry["index"] >= audit["index"]:
        return "the asset was registered after the claim"
    if not _included(entry, found["proof"], audit):
        return "its inclusion proof does not lead to the log's root"
    if (attested := document.get("attested")) is not None:
        drawn = attested["drawn"] and "drawn_sha256" not in entry["payload"]
        if attested["at"] != entry["at"] or drawn:
            return "what is attested is not what the log says"
    return _first_fault(document, first, entry) if first is not None else ""


def _first_fault(document: Mapping[str, Any], found: Mapping[str, Any], registered: Mapping[str, Any]) -> str:
    """What is wrong with the first registration of the original."""
    entry, original = found["entry"], document["original"]
    same = (
        entry["event"] == ASSET_REGISTERED
        and entry["tenant"] == registered["tenant"]
        and entry["at"] == original["registered_at"]
        and entry["payload"].get("original_sha256") == original["sha256"]
        and entry["index"] <= registered["index"]
    )
    if not same:
        return "the log first registered another original, or at another time"
    return "" if _included(entry, found["proof"], document["audit"]) else "the first registration is not in the log"


def _included(entry: Mapping[str, Any], proof: Sequence[str], audit: Mapping[str, Any]) -> bool:
    try:
        steps, root = [bytes.fromhex(step) for step in proof], bytes.fromhex(audit["root"])
    except ValueError:
        return False
    return check_inclusion(leaf_hash(canonical(entry)), entry["index"], audit["size"], steps, root)


def _around(data: bytes, carried: Carried, document: Document, payload: bytes) -> list[Check]:
    """Whether the readable part of the file says what was signed."""
    if carried.kind == "json":
        same = _canonical_or_none(carried.document) == payload
        text = "The document is the one that was signed." if same else "the document is not the one that was signed"
        found = [Check("document", Status.PASS if same else Status.FAIL, text)]
        if carried.summary is not None:
            found.append(_drawn("summary", carried.summary == summary_of(document).model_dump(), document))
        return found
    if carried.kind == "jws":
        return []
    digests = {name: hashlib.sha256(picture).hexdigest() for name, picture in carried.pictures.items()}
    same = digests == document["pictures"]
    text = "The pictures are those that were signed." if same else "the pictures are not those that were signed"
    pictures = Check("pictures", Status.PASS if same else Status.FAIL, text)
    page = report_html(document, carried.jws, carried.pictures, carried.timestamp).encode()
    return [pictures, _drawn("page", page == data, document)]


def _drawn(code: str, same: bool, document: Mapping[str, Any]) -> Check:
    """Whether the words around the claim are the ones that this program writes for it."""
    if same:
        return Check(code, Status.PASS, f"Every word of the {code} follows from what was signed.")
    ours = document["tool"]["version"]
    text = (
        f"the {code} is not the one that this program draws from the signed claim (made by version {ours}): rely on"
        " the signed claim only"
    )
    return Check(code, Status.FAIL, text)


def _kind(token: bytes, listed: Certificates) -> str:
    """Whether a stamp is a qualified one, to end a sentence with."""
    kind = qualification(token, listed)
    return f": {kind}" if kind else ""


def _stamp(token: bytes, jws: str, certificates: Certificates, listed: Certificates) -> Check:
    try:
        if certificates:
            at = check_stamp(token, jws.encode(), certificates)
            text = f"Stamped on {at} by a trusted service{_kind(token, listed)}."
            return Check("timestamp", Status.PASS, text)
        at = stamped_at(token, jws.encode())
    except TimestampFault as fault:
        return Check("timestamp", Status.FAIL, str(fault))
    text = f"A time stamp of {at} is there; its author was not checked: {UNTRUSTED}."
    return Check("timestamp", Status.NOT_CHECKED, text)


def _drawing(document: Mapping[str, Any], certificates: Certificates, listed: Certificates) -> Check:
    """Whether the stamp is about this original, and what it draws is what was registered."""
    drawing, original, found = document["drawing"], document["original"], document["audit"]["registration"]
    try:
        if original is None or found is None:
            raise TimestampFault("a time stamp drew for a record that the claim does not name")
        draw = Draw(base64.b64decode(drawing["token"], validate=True), original["sha256"], drawing["terms"])
        stamped_at(draw.token, draw.stamped)
        drawn = drawn_from(draw.token)
        if found["entry"]["payload"].get("drawn_sha256") != hashlib.sha256(drawn.encode()).hexdigest():
            raise TimestampFault("the time stamp's draw is not the registered one")
        if certificates:
            witness = draw.check(drawn, certificates)
            text = f"Drawn on {witness.at} by {witness.by}, a trusted service{_kind(draw.token, listed)}."
            return Check("drawing", Status.PASS, text)
    except (TimestampFault, ValueError) as fault:
        return Check("drawing", Status.FAIL, str(fault))
    text = f"The rate rests on a time stamp; its author was not checked: {UNTRUSTED}."
    return Check("drawing", Status.NOT_CHECKED, text)


def _acquisition(document: Mapping[str, Any], certificates: Certificates, listed: Certificates) -> Check:
    """Whether the suspect is the acquired file, logged before the claim, and who attests when it existed."""
    acquired, audit = document.get("acquisition"), document["audit"]
    found = audit.get("acquisition")
    if acquired is None or found is None:
        return Check("acquisition", Status.FAIL, "the claim and the log do not both name an acquisition")
    facts, entry = acquisition_facts(acquired), found["entry"]
    logged = (ACQUISITION_MADE, acquired["id"], audit["entry"]["tenant"], digest(facts))
    if logged != (entry["event"], entry["subject"], entry["tenant"], entry["payload"].get("digest")):
        return Check("acquisition", Status.FAIL, "the log's entry names another acquisition")
    if entry["index"] >= audit["index"] or not _included(entry, found["proof"], audit):
        return Check("acquisition", Status.FAIL, "the acquisition is not in the log, or came after the claim")
    if acquired["at"] > entry["at"]:
        return Check("acquisition", Status.FAIL, "the acquisition was logged before it was made")
    if acquired["payload_sha256"] not in document["subject"]["sha256"]:
        return Check("acquisition", Status.FAIL, "the file that was acquired is not the suspect")
    url = acquired["url"]
    origin = f"The suspect is the file that was {'fetched' if url else 'uploaded'} on {acquired['at']}"
    origin += f" from {url}, as the service states" if url else "; only its owner states its origin"
    if acquired["timestamp"] is None:
        text = f"{origin}; only the service states that it existed by then: its log has it on {entry['at']}."
        return Check("acquisition", Status.NOT_CHECKED, text)
    try:
        token, stamped = base64.b64decode(acquired["timestamp"], validate=True), canonical(facts)
        at = check_stamp(token, stamped, certificates) if certificates else stamped_at(token, stamped)
    except (TimestampFault, ValueError) as fault:
        return Check("acquisition", Status.FAIL, f"the time stamp of the acquisition: {fault}")
    if certificates:
        text = f"{origin}; {authority_of(token)} attests that it existed on {at}{_kind(token, listed)}."
        return Check("acquisition", Status.PASS, text)
    text = f"{origin}; a time stamp says that it existed on {at}; its author was not checked: {UNTRUSTED}."
    return Check("acquisition", Status.NOT_CHECKED, text)


def _canonical_or_none(value: Any) -> bytes | None:
    try:
        return canonical(value)
    except (ValueError, RecursionError):
        return None


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
