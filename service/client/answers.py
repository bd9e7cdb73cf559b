"""What the service answers, as values. Members that a later service adds are passed over."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal, TypeVar, cast

from service.client.errors import ServiceError, of_problem

A = TypeVar("A")
FINAL = frozenset({"succeeded", "disputed", "failed", "cancelled"})


def read(kind: type[A], plain: Any) -> A:
    """A value of a dataclass of this file from a JSON object; ServiceError where a member without a default is missing.

    Defaults stand for members that services of an earlier version do not send.
    """
    names = [each.name for each in fields(cast(Any, kind))]
    try:
        return kind(**{name: plain[name] for name in names if name in plain})
    except TypeError as error:
        text = f"no {kind.__name__}: {type(error).__name__} {error} in {str(plain)[:200]}"
        raise ServiceError("unexpected-answer", text) from None


@dataclass(frozen=True)
class Upload:
    """A file on its way, or there."""

    id: str
    name: str
    size: int | None
    offset: int  # bytes that are there
    state: Literal["open", "complete"]
    sha256: str | None
    info: Mapping[str, Any] | None  # kind: model, picture or cameras; format, gaussians, ...


@dataclass(frozen=True)
class Job:
    """A job as it stands; times are UTC, ISO 8601."""

    id: str
    kind: Literal["embed", "verify", "dispute"]
    state: Literal["queued", "running", "succeeded", "disputed", "failed", "cancelled"]
    stage: str
    fraction: float
    cancelling: bool
    result: Mapping[str, Any] | None
    problem: Mapping[str, Any] | None
    created_at: str
    started_at: str | None
    finished_at: str | None
    position: int | None = None  # in the queue, 1 is next; None unless queued
    name: str = ""  # what it is about: the label, or the names of the files
    copy_name: str = ""  # recipient of the marked copy
    fraction_total: float | None = None  # of the whole job; None if unknown

    @property
    def ended(self) -> bool:
        """Nothing more will come of it."""
        return self.state in FINAL

    def outcome(self) -> Mapping[str, Any]:
        """Its result; ServiceError if it failed, was cancelled, found a dispute, or has not ended."""
        if self.state == "succeeded" and self.result is not None:
            return self.result
        if self.problem is not None:
            try:
                raise of_problem(self.problem, job=self.id)
            except (KeyError, TypeError, ValueError):
                pass
        text = str((self.result or {}).get("text", f"job {self.id} is {self.state}, stage {self.stage!r}"))
        code = self.state if self.state in ("disputed", "cancelled") else "unexpected-answer"
        raise ServiceError(code if self.ended else "timed-out", text, values={"job": self.id})


@dataclass(frozen=True)
class Embedded:
    """The result of marking a model."""

    asset_id: str
    record_id: str
    message: str  # hexadecimal
    psnr_worst_view: float  # dB of the watermark alone, without pruning
    ssim_worst_view: float
    gaussians: int
    seconds: float
    already_carries: list[str]  # the tenant's own assets whose mark the model carried before
    psnr_total_worst_view: float | None = None  # dB against the original, with pruning
    psnr_as_written: float | None = None  # the same of the file read back: with a format's rounding
    not_screened: int = 0  # copies that it resembles and that were not looked for, since they are too many


@dataclass(frozen=True)
class Check:
    """One thing that was checked; `ok` is None where it could not be."""

    code: str
    ok: bool | None
    text: str


@dataclass(frozen=True)
class Bits:
    """A payload, most significant bit first."""

    string: str  # 0 and 1; ? where nothing of a bit was read
    hex: str | None = None  # None where a bit was not read


@dataclass(frozen=True, kw_only=True)
class Reading:
    """What was read of one registered mark in the suspect, with the owner's record and key (informed detection)."""

    verdict: Literal["marked", "not_marked", "inconclusive"]
    log10_false_claim: float  # upper bound on the probability that an unrelated key scores this high, log10
    headline: str = ""  # the verdict in words
    bits: Bits | None = None  # as extracted; None where nothing was read
    no_bits: str | None = None  # why there are none
    registered_bits: Bits | None = None
    matching: int | None = None  # bits that were read as registered
    bit_accuracy: float | None = None  # matching / length; pure chance gives about 0.5
    reliability: list[float] | None = None  # per bit: probability of a right reading; 0.5 is a coin
    z: float | None = None  # detection statistic; 0 +- 1 without a mark
    hypotheses: int | None = None  # tested; every bound is corrected for them
    strength: float = 0.0  # -log2 of the bound: 30 is 1 in 10^9; 128 is needed without an attested date
    confidence: float  # 1 - bound; rounds to 1.0 from a strength of 53 on. Not the probability of a mark
    derived_fraction: float | None = None  # share of the registered model in the suspect


@dataclass(frozen=True, kw_only=True)
class AssetReading(Reading):
    """Of one more asset that was recognised."""

    asset_id: str
    copy_name: str = ""


@dataclass(frozen=True, kw_only=True)
class Verified(Reading):
    """The result of comparing a suspect with one asset, or with all: of the asset with the strongest evidence."""

    claim_id: str
    asset_id: str | None  # None where none of all was recognised
    checks: list[Check]
    others: list[AssetReading] = field(default_factory=list)
    links: Mapping[str, str] = field(default_factory=dict)  # claim, jws, report; asset; pack, where there is one
    timestamp_failure: str = ""  # why there is no time stamp


@dataclass(frozen=True)
class Asset:
    """One registered embedding."""

    id: str
    label: str
    copy_name: str
    owner_key_id: str
    record_id: str
    message: str
    profile: str
    gaussians: int
    original_sha256: str
    original_format: str
    model_sha256: str
    model_format: str
    registered_at: str
    report: Mapping[str, Any]  # measurements of the embedding


@dataclass(frozen=True)
class Condition:
    """Under which an inconclusive answer would be a claim."""

    kind: str  # registered_before or suspect_since; empty in claims before version 4, which have the text alone
    date: str | None  # since when the suspect is known
    by: str  # who vouches for it: owner, or attestation (which does not exist yet)
    text: str


@dataclass(frozen=True)
class Claim:
    """A signed claim; docs/CLAIM.md has its document."""

    document: Mapping[str, Any]
    jws: str
    timestamp: str | None
    summary: Mapping[str, Any]

    @property
    def conditions(self) -> list[Condition]:
        """The document's conditions."""
        known = self.document.get("conditions", [])
        return [Condition("", None, "", each) if isinstance(each, str) else Condition(**each) for each in known]


@dataclass(frozen=True)
class ClaimSummary:
    """A claim in a list."""

    id: str
    asset_id: str | None
    verdict: str
    headline: str
    finding: str
    log10_false_claim: float
    created_at: str
    suspects: list[str] = field(default_factory=list)  # of the suspect's files
    asset_label: str | None = None
    copy_name: str | None = None


@dataclass(frozen=True)
class Share:
    """An address under which a claim's report is seen without an API key."""

    id: str
    claim_id: str
    created_at: str
    expires_at: str
    url: str | None = None  # shown only once, on creation


@dataclass(frozen=True)
class Acquisition:
    """A suspect kept as it was found."""

    id: str
    url: str | None  # None for an uploaded file
    at: str
    bytes: int
    payload_sha256: str
    warc_sha256: str
    upload_id: str | None  # to verify; None of what is no suspect
    timestamp: str | None  # RFC 3161 token, base64
    timestamp_failure: str = ""  # why there is none, on creation


@dataclass(frozen=True)
class Webhook:
    """An address that receives a message when a job ends."""

    id: str
    url: str
    events: list[str]
    created_at: str
    waiting: int = 0  # messages that are still to be delivered
    last_at: str | None = None  # of the last attempt
    last_status: int | None = None  # HTTP status; None where no answer came
    last_outcome: str | None = None  # in words
    secret: str | None = None  # shown only once, on creation


@dataclass(frozen=True)
class Notice:
    """A mark of the tenant's in what another account uploaded to be marked."""

    id: str
    asset_id: str  # of the tenant; of several copies, the one with the strongest evidence
    copy_named: bool | None  # whether the upload is that copy
    z: float
    log10_false_claim: float
    strength: float  # -log2 of the bound, in bits
    uploaded_as: str  # asset that the upload became, for a dispute
    created_at: str


@dataclass(frozen=True)
class Event:
    """A message to a webhook."""

    event: str  # job.ended, mark.found
    at: str  # when it happened
    job: Job | None = None  # that ended
    notice: Notice | None = None  # of a mark that was found


@dataclass(frozen=True)
class Me:
    """The API key of the client, and its tenant."""

    tenant: str
    name: str  # display name of the tenant
    key: Mapping[str, Any]  # id, label, scopes, prefix
    limits: Mapping[str, Mapping[str, int]]  # name: used, most
    is_named: bool = True  # whether a display name was entered
    service: Mapping[str, Any] = field(default_factory=dict)  # public_url, may_set_public_url, parts


def embedded(job: Job) -> Embedded:
    """The result of an embed job; ServiceError if it has none."""
    return read(Embedded, job.outcome())


def verified(job: Job) -> Verified:
    """The result of a verify job; ServiceError if it has none."""
    plain = job.outcome()
    checks = [read(Check, each) for each in plain.get("checks", ())]
    others = [read(AssetReading, each | _bits(each)) for each in plain.get("others", ())]
    return read(Verified, {**plain, **_bits(plain), "checks": checks, "others": others})


def _bits(plain: Mapping[str, Any]) -> dict[str, Bits]:
    return {name: read(Bits, plain[name]) for name in ("bits", "registered_bits") if plain.get(name) is not None}
