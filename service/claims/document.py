"""The claim document: what is signed. Made from the reply of the task `verify` and what the registry knows."""

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any, cast

from pydantic import BaseModel, Field

from engine.present.checks import named
from engine.present.numerals import TYPOGRAPHIC, Form, when
from engine.present.reading import reading_of
from engine.present.wording import Words, recognizes, words_of
from engine.records.timestamps import stamped_at
from engine.watermark.claim import NOT_FOUND, Derivation
from service.claims.schema import SCHEMA_VERSION, ClaimDocument, Document
from service.clock import LOG
from service.http.results import Reading
from service.trust.audit import Entry
from service.trust.canonical import canonical
from service.trust.commitments import acquisition_facts


class Fact(BaseModel):
    """Something that was found."""

    label: str
    text: str


class Bar(BaseModel):
    """The threshold of a bound."""

    log10: float
    text: str


class NamedCheck(BaseModel):
    """A check of the document, with its name and outcome for people."""

    code: str
    ok: bool | None
    text: str
    name: str
    outcome: str


class Summary(BaseModel):
    """The claim in words, and what was read; all of it follows from the document, and is not signed itself."""

    headline: str
    finding: str = Field(description="The verdict in one sentence.")
    facts: list[Fact]
    limits: list[Bar]
    checks: list[NamedCheck]
    reading: Reading


def of_what_was_found(reply: Mapping[str, Any]) -> Mapping[str, Any]:
    """The reply of the task `verify` with what was `searched` in full; of all of an owner's assets, it names
    one only where that one was recognised."""
    claim, tried = reply["claim"], reply["tried"]
    recognised = claim is not None and recognizes(claim)
    unreadable = sum(each["verdict"] == "could_not_check" for each in tried)
    counted = {"compared": len(tried), "unreadable": unreadable, "recognised": recognised}
    full = {**reply, "searched": {**reply["searched"], **counted}}
    if recognised or reply["searched"]["scope"] == "one":
        return full
    text = f"None of {reply['searched']['assets']} registered assets was recognised; records compared: {len(tried)}"
    text += f", of which {unreadable} could not be opened." if unreadable else "."
    unnamed = dict.fromkeys(("asset", "claim", "attested", "drawing", "registered_message", "regions"))
    kept = {name: digest for name, digest in reply["kept"].items() if name == "suspect"}  # the others show an asset
    return full | unnamed | {"kept": kept, "checks": [{"code": "derived", "ok": None, "text": text}]}


@dataclass(frozen=True)
class Registered:
    """The asset that a claim is about, if it is about one, and what the log says of it."""

    asset: Mapping[str, Any] | None = None  # its row
    registration: Entry | None = None
    first: Entry | None = None  # registration of its original's first copy by this tenant


def build_document(
    reply: Mapping[str, Any],
    suspect: Sequence[str],
    registered: Registered,
    *,
    claim_id: str,
    created_at: str,
    issuer: Mapping[str, str] | None = None,
    owner: str = "",
    acquisition: Mapping[str, Any] | None = None,
) -> Document:
    """The document without its member `audit`, as JSON values.

    Made of the `reply` of the task `verify`, whose pictures are stored already. `suspect`: SHA-256 of each file
    that was examined, in order. `issuer` has `name` and `address`; `owner` is the display name of the tenant;
    `acquisition` is the member of that name.
    """
    asset = registered.asset
    registered_at, first_at = (
        entry.at if entry is not None else "" for entry in (registered.registration, registered.first)
    )
    claim, subject = reply["claim"], reply["subject"]
    plain: Document = {
        "schema_version": SCHEMA_VERSION,
        "claim_id": claim_id,
        "created_at": created_at,
        "tool": {"name": "mark3dgs", "version": version("mark3dgs")},
        "issuer": dict(issuer) if issuer is not None else None,
        "owner": {"name": owner} if owner else None,
        "acquisition": acquisition,
        "searched": reply["searched"],
        "subject": {
            "kind": "pictures" if subject["pictures"] else "model",
            "sha256": list(suspect),
            "format": subject["format"] or "pictures",
            "gaussians": subject["gaussians"],
        },
        **dict.fromkeys(("asset", "original", "record_id", "copy", "registered_at")),
        "attested": {**reply["attested"], "at": registered_at} if reply["attested"] is not None else None,
        "drawing": reply.get("drawing"),  # replies of before have none
        "tries": reply["tries"],
        "checks": [{name: check[name] for name in ("code", "ok", "text")} for check in reply["checks"]],
        "pictures": dict(reply["kept"]),
        "regions": reply.get("regions"),  # replies of before have none
        **(_found(claim, reply["registered_message"]) if claim is not None else _NOTHING),
    }
    if acquisition is not None:
        ok = True if acquisition["timestamp"] is not None else None  # without, only the service states it
        plain["checks"].append({"code": "acquisition", "ok": ok, "text": _acquisition_text(acquisition)})
    if claim is None and reply["searched"]["compared"] > reply["searched"]["unreadable"]:
        plain["missing"] = "something of a registered asset that can be recognised"
    if asset is not None:
        plain |= {
            "asset": asset["id"],
            "original": {
                "sha256": asset["original_sha256"],
                "format": asset["original_format"],
                "registered_at": first_at,
            },
            "record_id": asset["record_id"],
            "copy": asset["copy"],
            "registered_at": registered_at,
        }
    plain["meaning"] = document_words(plain).meaning
    return ClaimDocument.model_validate(plain).model_dump(by_alias=True, exclude={"audit"})


def _acquisition_text(acquisition: Mapping[str, Any]) -> str:
    """Where the suspect comes from, and who attests it."""
    url, token = acquisition["url"], acquisition["timestamp"]
    origin = f"was fetched from {url}" if url else "was uploaded"
    text = f"The suspect {origin} on {when(acquisition['at'])}, as the issuing service states; "
    if token is None:
        return text + "no third party attests the time."
    at = stamped_at(base64.b64decode(token), canonical(acquisition_facts(acquisition)))
    return text + f"a time stamp attests that it existed on {when(at)}."


_BOUND = ("verdict", "confidence", "log10_false_claim", "meets_dishonest_claimant_rate", "would_be_claim_if_attested")
_SAME = (
    *_BOUND,
    "conditions",
    "layers",
    "copy_z",
    "copy_named",
    "derived_fraction",
    "derivation",
    "transform",
    "missing",
    "notes",
)
_MESSAGE = {
    "hex": "message",
    "bits": "bits",
    "matching": "matching_bits",
    "bit_accuracy": "bit_accuracy",
    "reliability": "bit_reliability",
    "log10_binomial_tail": "log10_binomial_tail",
}
_THRESHOLD = {"false_claim_rate": "false_claim_rate", "z": "z_threshold", "basis": "rate_basis"}
_EVIDENCE = ("route", "z", "unmarked_z", "expected_z", "power", "change")
"""Members of the document, and what the engine calls them."""

_NOTHING: Document = {
    "verdict": "inconclusive",
    "confidence": 0.0,
    "log10_false_claim": 0.0,
    "meets_dishonest_claimant_rate": False,
    "would_be_claim_if_attested": False,
    "conditions": [],
    "layers": None,
    "copy_z": None,
    "copy_named": None,
    "threshold": None,
    "message": None,
    "derived_fraction": None,
    "derived_but_unmarked": False,
    "derivation": asdict(NOT_FOUND),
    "transform": None,
    "evidence": [],
    "missing": "nothing registered could be compared with this suspect",
    "notes": [],
}


def _found(claim: Mapping[str, Any], registered: str) -> Document:
    plain: Document = json.loads(json.dumps({name: claim[name] for name in _SAME}))  # tuples become lists
    return plain | {
        "derived_but_unmarked": claim["verdict"] == "not_marked",
        "threshold": {name: claim[theirs] for name, theirs in _THRESHOLD.items()},
        "message": {name: claim[theirs] for name, theirs in _MESSAGE.items()} | {"registered": registered},
        "evidence": [{name: claim[name] for name in _EVIDENCE}],
    }


def document_words(document: Mapping[str, Any], form: Form = TYPOGRAPHIC) -> Words:
    """The document in the engine's words; an old document's words are written anew, but for its own `meaning`."""
    subject = document["subject"]
    pictures = len(subject["sha256"]) if subject["kind"] == "pictures" else 0
    return words_of(_claim_of(document), form, pictures=pictures)


def document_reading(document: Mapping[str, Any]) -> Reading:
    """The reading, as `mark3dgs verify --json` has it."""
    read = reading_of(_claim_of(document), (document["message"] or {}).get("registered"))
    return cast("Reading", read.to_json())


def no_pack(document: Mapping[str, Any]) -> str:
    """Why there is no pack for a platform; "" where there is one."""
    if document["verdict"] == "not_marked":
        return "the suspect is the unmarked original, or a part of it: your watermark is not in it"
    if not recognizes(_claim_of(document)):
        return "this claim recognised nothing of the asset"
    return ""


def _claim_of(document: Mapping[str, Any]) -> Document:
    """The engine's claim, as far as a document holds it."""
    message, threshold = document["message"] or {}, document["threshold"] or {}
    evidence = document["evidence"][0] if document["evidence"] else {}
    claim = {
        **{name: document[name] for name in ("tries", "copy", "record_id")},
        **{name: document.get(name) for name in _SAME},
        **{theirs: message.get(name) for name, theirs in _MESSAGE.items()},
        **{theirs: threshold.get(name) for name, theirs in _THRESHOLD.items()},
        **{name: evidence.get(name) for name in _EVIDENCE},
        "searched": document.get("searched"),
        "registered_at": "",  # the owner's own date is not in it: the log's is
        "attested": document.get("attested"),
    }
    if document["schema_version"] == 1:
        claim |= _of_first_version(document)
    return claim


def _of_first_version(document: Mapping[str, Any]) -> Document:
    """What documents of version 1 did not say, as far as it follows from what they did."""
    share, at = document["derived_fraction"], document["registered_at"]
    derived = document["derived_but_unmarked"] or document["verdict"] == "marked"
    return {
        "derivation": asdict(Derivation(derived, share if derived else None)),
        "attested": {"at": at, "by": LOG, "drawn": False} if at else None,
    }


def summary_of(document: Mapping[str, Any]) -> Summary:
    """The words as the API returns them with the document."""
    words = document_words(document)
    return Summary(
        headline=words.headline,
        finding=words.finding,
        facts=[Fact(label=fact.label, text=fact.text) for fact in words.facts],
        limits=[Bar(log10=log10, text=text) for log10, text in words.limits],
        checks=[NamedCheck.model_validate(check) for check in named(document["checks"])],
        reading=document_reading(document),
    )
