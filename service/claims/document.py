"""The claim document: what is signed. Made from the reply of the task `verify` and what the registry knows."""

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from engine.watermark.checks import named
from engine.watermark.wording import TYPOGRAPHIC, Form, Words, words_of

SCHEMA_VERSION = 1

Hex64 = Field(pattern=r"^[0-9a-f]{64}$")
Share = Field(ge=0.0, le=1.0)


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Tool(_Part):
    """The program that made the claim."""

    name: str
    version: str


class Subject(_Part):
    """What was examined."""

    kind: Literal["model", "pictures"]
    sha256: list[str] = Field(min_length=1, description="Of each file handed in, hex, in order.")
    format: str = Field(description="File format of a model, or `pictures`.")
    gaussians: int | None = Field(description="Of a model.")


class Original(_Part):
    """The file that its owner registered."""

    sha256: str = Hex64
    format: str
    registered_at: str = Field(description="When a copy of it was first registered here, UTC.")


class Threshold(_Part):
    """The bar, set before the evidence was looked at."""

    false_claim_rate: float = Field(gt=0.0, lt=1.0, description="Largest acceptable false-claim bound.")
    z: float = Field(description="The z at which the bound meets that rate for this number of tries.")


class Message(_Part):
    """The bits."""

    hex: str = Field(description="As extracted; a bit without evidence reads 0.")
    registered: str = Field(description="As registered.")
    bits: int = Field(gt=0)
    matching: int = Field(ge=0)
    bit_accuracy: float = Share
    reliability: list[float] = Field(description="For each bit, the probability that it was read right.")
    log10_binomial_tail: float = Field(description="log10 of the chance that as many bits match by luck.")


class Evidence(_Part):
    """One kind of evidence."""

    route: str = Field(description="model, render or image.")
    z: float = Field(description="The claim statistic as observed.")
    unmarked_z: float = Field(description="What is expected without a mark, with a standard deviation of 1.")
    expected_z: float = Field(description="What is expected of the mark at full strength.")
    power: float = Field(
        description="Least chance that a mark worn to half strength, or a piece of the model, would be seen."
    )


class Check(_Part):
    """One thing that was checked. `ok` is null where it could not be."""

    code: str
    ok: bool | None
    text: str


class Meaning(_Part):
    """What the claim means, and what it does not."""

    says: str
    does_not_say: str
    method: str
    record_time: str


class LogEntry(_Part):
    """An entry of the audit log; its canonical JSON is the leaf."""

    index: int = Field(ge=0)
    at: str
    tenant: str
    event: str
    subject: str
    payload: dict[str, Any]
    previous: str = Hex64


class Registration(_Part):
    """The asset's registration in the same log, under the same root."""

    entry: LogEntry
    proof: list[str]


class Audit(_Part):
    """Where the claim stands in the audit log. The entry's digest is that of the document without this member."""

    index: int = Field(ge=0)
    size: int = Field(gt=0)
    root: str = Hex64
    proof: list[str]
    entry: LogEntry
    registration: Registration | None


class ClaimDocument(_Part):
    """The answer of one verification, as it is signed."""

    schema_version: Literal[1]
    claim_id: str
    created_at: str
    tool: Tool
    subject: Subject
    asset: str | None = Field(description="The asset that the answer is about; null where none could be compared.")
    original: Original | None
    record_id: str | None
    copy_name: str | None = Field(alias="copy", description="Recipient of the copy whose mark was looked for.")
    registered_at: str | None = Field(description="When that copy entered the audit log, UTC.")
    verdict: Literal["marked", "not_marked", "inconclusive"]
    confidence: float = Field(ge=0.0, le=1.0, description="1 - min(1, false-claim bound), all tries counted.")
    log10_false_claim: float = Field(le=0.0, description="log10 of the false-claim bound, all tries counted.")
    meets_dishonest_claimant_rate: bool = Field(description="Whether the bound is at most 2^-128 too.")
    tries: int = Field(ge=0, description="Hypotheses tried: records times routes.")
    threshold: Threshold | None
    message: Message | None
    derived_fraction: float | None = Field(description="Share of the registered model found in the suspect.")
    derived_but_unmarked: bool
    transform: dict[str, Any] | None = Field(description="From suspect to registered model.")
    evidence: list[Evidence]
    checks: list[Check]
    missing: str = Field(description="What an inconclusive answer lacks.")
    notes: list[str]
    pictures: dict[str, str] = Field(description="Name and SHA-256 of each picture of the report.")
    meaning: Meaning
    audit: Audit | None = Field(default=None, description="Always there in a signed document.")


def build_document(
    reply: Mapping[str, Any],
    *,
    claim_id: str,
    created_at: str,
    sha256: Sequence[str],
    asset: Mapping[str, Any] | None,
    registered_at: str,
    original_registered_at: str,
    pictures: Mapping[str, str],
) -> dict[str, Any]:
    """The document without its member `audit`, as JSON values.

    Made of the `reply` of the task `verify`, the `sha256` of each file handed in, and those of the report's `pictures`
    by name. `asset` is the row of the asset that the reply names, if it names one; the two dates say when it entered
    the log, and when a copy of its original was first registered.
    """
    claim, subject = reply["claim"], reply["subject"]
    plain: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "claim_id": claim_id,
        "created_at": created_at,
        "tool": {"name": "mark3dgs", "version": version("mark3dgs")},
        "subject": {
            "kind": "pictures" if subject["pictures"] else "model",
            "sha256": list(sha256),
            "format": subject["format"] or "pictures",
            "gaussians": subject["gaussians"],
        },
        **dict.fromkeys(("asset", "original", "record_id", "copy", "registered_at")),
        "tries": reply["tries"],
        "checks": [{name: check[name] for name in ("code", "ok", "text")} for check in reply["checks"]],
        "pictures": dict(pictures),
        **(_found(claim, reply["registered_message"]) if claim is not None else _NOTHING),
    }
    if asset is not None:
        plain |= {
            "asset": asset["id"],
            "original": {
                "sha256": asset["original_sha256"],
                "format": asset["original_format"],
                "registered_at": original_registered_at,
            },
            "record_id": asset["record_id"],
            "copy": asset["copy"],
            "registered_at": registered_at,
        }
    plain["meaning"] = document_words(plain).meaning
    return ClaimDocument.model_validate(plain).model_dump(by_alias=True, exclude={"audit"})


_BOUND = ("verdict", "confidence", "log10_false_claim", "meets_dishonest_claimant_rate")
_SAME = (*_BOUND, "derived_fraction", "derived_but_unmarked", "transform", "missing", "notes")
_MESSAGE = {
    "hex": "message",
    "bits": "bits",
    "matching": "matching_bits",
    "bit_accuracy": "bit_accuracy",
    "reliability": "bit_reliability",
    "log10_binomial_tail": "log10_binomial_tail",
}
_THRESHOLD = {"false_claim_rate": "false_claim_rate", "z": "z_threshold"}
_EVIDENCE = ("route", "z", "unmarked_z", "expected_z", "power")
"""Members of the document, and what the engine calls them."""

_NOTHING: dict[str, Any] = {
    "verdict": "inconclusive",
    "confidence": 0.0,
    "log10_false_claim": 0.0,
    "meets_dishonest_claimant_rate": False,
    "threshold": None,
    "message": None,
    "derived_fraction": None,
    "derived_but_unmarked": False,
    "transform": None,
    "evidence": [],
    "missing": "nothing registered could be compared with this suspect",
    "notes": [],
}


def _found(claim: Mapping[str, Any], registered: str) -> dict[str, Any]:
    return {name: claim[name] for name in _SAME} | {
        "threshold": {name: claim[theirs] for name, theirs in _THRESHOLD.items()},
        "message": {name: claim[theirs] for name, theirs in _MESSAGE.items()} | {"registered": registered},
        "evidence": [{name: claim[name] for name in _EVIDENCE}],
    }


def document_words(document: Mapping[str, Any], form: Form = TYPOGRAPHIC) -> Words:
    """The document in the engine's words; those of an old document are made anew, but for its own `meaning`."""
    message, threshold = document["message"] or {}, document["threshold"] or {}
    evidence = document["evidence"][0] if document["evidence"] else {}
    claim = {
        **{name: document[name] for name in (*_SAME, "tries", "copy", "record_id", "registered_at")},
        **{theirs: message.get(name) for name, theirs in _MESSAGE.items()},
        **{theirs: threshold.get(name) for name, theirs in _THRESHOLD.items()},
        **{name: evidence.get(name) for name in _EVIDENCE},
    }
    subject = document["subject"]
    pictures = len(subject["sha256"]) if subject["kind"] == "pictures" else 0
    return words_of(claim, form, pictures=pictures, logged=True)


def summary_of(document: Mapping[str, Any]) -> dict[str, Any]:
    """The words as the API hands them out beside the document, JSON values."""
    words = document_words(document)
    return {
        "headline": words.headline,
        "finding": words.finding,
        "facts": [{"label": fact.label, "text": fact.text} for fact in words.facts],
        "limits": [{"log10": log10, "text": text} for log10, text in words.limits],
        "checks": named(document["checks"]),
    }
