"""The claim document: its exact form. Version 1 had no derivation, no basis of its rate, no proof of the original's
registration; version 2 did not say who issued it for whom, and what was searched; version 3 wrote conditions as
sentences, and rested 1 in 10^9 on dates and on what the service drew by itself. All are still read."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    HttpUrl,
    StringConstraints,
    UrlConstraints,
    model_validator,
)

SCHEMA_VERSION = 4
DRAWN_BY_STAMP = 4
"""From this version on a rate above 2^-128 rests on a time stamp in the document that drew for the record."""

Hex64 = Field(pattern=r"^[0-9a-f]{64}$")
Share = Field(ge=0.0, le=1.0)


def _moment(text: str) -> str:
    if datetime.fromisoformat(text).tzinfo is None:
        raise ValueError("a time names its offset from UTC")
    return text


Moment = Annotated[str, AfterValidator(_moment), Field(json_schema_extra={"format": "date-time"})]
"""A time, ISO 8601 with its offset."""
Layer = Literal[
    "tint",
    "grain",
    "both",
    "tint_by_scatter",
    "grain_by_scatter",
    "both_by_scatter",
    "tint_unsaturated",
    "grain_unsaturated",
    "both_unsaturated",
]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Tool(_Part):
    """The program that made the claim."""

    name: str
    version: str


class Subject(_Part):
    """What was examined."""

    kind: Literal["model", "pictures"]
    sha256: list[str] = Field(min_length=1, description="Of each file of the suspect, hex, in order.")
    format: str = Field(description="File format of a model, or `pictures`.")
    gaussians: int | None = Field(description="Of a model.")


class Issuer(_Part):
    """The service that signed."""

    name: str
    address: str = Field(description="Where it answers, and its public keys are; empty where its operator set none.")


class Owner(_Part):
    """The owner of the claim; the log's entries name the tenant."""

    name: str = Field(description="Display name of the tenant, as the operator entered it.")


class Searched(_Part):
    """Among what the suspect was looked for."""

    scope: Literal["one", "all"] = Field(description="One asset that was named, or all of the owner's.")
    assets: int = Field(gt=0)
    compared: int = Field(ge=0, description="Records compared with the suspect; the index ruled out the rest.")
    unreadable: int = Field(ge=0, description="Of these, records that could not be opened.")
    recognised: bool = Field(description="Something of the asset named below was found in the suspect.")


class Original(_Part):
    """The file that its owner registered."""

    sha256: str = Hex64
    format: str
    registered_at: str = Field(description="When a copy of it first entered the audit log, UTC.")


class Threshold(_Part):
    """The bar, set before the evidence was looked at."""

    basis: str | None = Field(None, description="Why this rate applies, a key of `engine.watermark.rates.BASES`.")
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
        description="Detection power: least probability of finding a watermark at half strength, removal aside."
    )
    change: float | None = Field(None, description="Size of what was measured, in sizes of the mark.")


class RegionCounts(_Part):
    """In how many regions of the registered model the mark was found; over all pieces of it that the suspect holds."""

    false_discovery_rate: float = Field(
        gt=0.0, lt=1.0, description="Largest expected share of regions without the mark among those called marked."
    )
    pieces: int = Field(ge=0, description="Pieces of the registered model found; pictures are one.")
    marked: int = Field(ge=0, description="Regions that carry the mark, at that rate.")
    altered: int = Field(ge=0, description="Regions that are there and whose mark would have shown, and does not.")
    unclear: int = Field(ge=0, description="Regions that were seen, and say too little.")
    unseen: int = Field(ge=0, description="Regions that the suspect does not show.")
    share: dict[Literal["marked", "altered", "unclear", "unseen"], float] = Field(
        description="Of the registered model's Gaussians, by what is known of where they are."
    )


class Derivation(_Part):
    """Whether the suspect was made from the asset, independent of the mark."""

    derived: bool
    share: float | None = Field(description="Share of the registered model's Gaussians found in the suspect.")
    gaussians: int | None = Field(description="Gaussians of the suspect that were recognised.")
    exactness: float | None = Field(description="Median distance from where the original has them, in their own sizes.")
    where: list[list[float]] | None = Field(description="Box around what was found, in the original's coordinates.")
    views: list[int] | None = Field(description="Pictures in which the asset was recognised, of so many.")


class AttestedTime(_Part):
    """Who says when the record was registered."""

    at: str
    by: str
    drawn: bool = Field(
        description="A time-stamping service drew a part of what the mark's chips follow from; before version 4, the"
        " attester."
    )


class Drawing(_Part):
    """The time stamp (RFC 3161) from whose signature a part of what the mark's chips follow from was drawn."""

    token: str = Field(pattern=r"^[A-Za-z0-9+/]+={0,2}$", max_length=1 << 17, description="The reply (DER), base64.")
    terms: str = Field(
        pattern=r"^[0-9a-f]{64}$",
        description="Keyed digest of owner key, reference and plan. Stamped are 'mark3dgs draw', a zero byte, the"
        " original's SHA-256 and these 32 bytes.",
    )


class Acquisition(_Part):
    """Where a file of the suspect comes from: a service fetched it, or took it, before it was examined."""

    id: str
    url: str | None = Field(
        description="The address that answered with it, as the service says; null where the owner handed the file in."
    )
    at: str = Field(description="When, UTC, as the service says.")
    payload_sha256: str = Hex64
    warc_sha256: str = Field(pattern=r"^[0-9a-f]{64}$", description="Of the WARC file (ISO 28500) that has all of it.")
    timestamp: str | None = Field(
        description="RFC 3161 token of the members above as canonical JSON, base64: a third party's proof that they,"
        " and so the suspect, existed by then; null where only the service states it."
    )


class Condition(_Part):
    """Under which a bound between the two rates would be a claim."""

    kind: Literal["registered_before", "suspect_since"]
    date: str | None = Field(description="Since when the suspect is known, ISO 8601; null of the other kind.")
    by: Literal["owner", "attestation"] = Field(
        description="What supports it: the owner's statement, or an attestation that does not exist yet."
    )
    text: str = Field(description="The same in words.")


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
    """The asset's registration, or the suspect's acquisition, in the same log, under the same root."""

    entry: LogEntry
    proof: list[str]


class EarlierLog(_Part):
    """The log as it was before, proven to be the beginning of what it is (RFC 6962)."""

    size: int = Field(gt=0)
    root: str = Hex64
    proof: list[str]


class Audit(_Part):
    """Where the claim stands in the audit log. The entry's digest is that of the document without this member."""

    index: int = Field(ge=0)
    size: int = Field(gt=0)
    root: str = Hex64
    proof: list[str]
    entry: LogEntry
    registration: Registration | None
    first_registration: Registration | None = Field(None, description="Of the original: its first copy's.")
    acquisition: Registration | None = Field(None, description="The entry of the suspect's acquisition.")
    earlier: list[EarlierLog] = Field(
        default_factory=list, description="Right after the asset's registration, and right after the claim before."
    )


Document = dict[str, Any]
"""A claim as it is signed: JSON of the form of `ClaimDocument`, or of an earlier version of it, member for member."""


class ClaimDocument(_Part):
    """The answer of one verification, as it is signed."""

    schema_version: Literal[1, 2, 3, 4]
    claim_id: str
    created_at: Moment
    tool: Tool
    issuer: Issuer | None = None
    owner: Owner | None = None
    subject: Subject
    acquisition: Acquisition | None = None
    searched: Searched | None = None
    asset: str | None = Field(description="The asset that the answer is about; null where none was recognised of all.")
    original: Original | None
    record_id: str | None
    copy_name: str | None = Field(alias="copy", description="Recipient of the copy whose record it is.")
    registered_at: str | None = Field(description="When that copy entered the audit log, UTC: attested.")
    attested: AttestedTime | None = Field(None, description="The same, as it counted for the rate.")
    drawing: Drawing | None = Field(None, description="By which a time-stamping service drew for the record.")
    verdict: Literal["marked", "not_marked", "inconclusive"]
    confidence: float = Field(ge=0.0, le=1.0, description="1 - min(1, false-claim bound), all tries counted.")
    log10_false_claim: float = Field(le=0.0, description="log10 of the false-claim bound, all tries counted.")
    meets_dishonest_claimant_rate: bool = Field(description="Whether the bound is at most 2^-128 too.")
    would_be_claim_if_attested: bool = Field(
        False, description="The bound would do if the conditions held; no attested date makes it a claim."
    )
    conditions: list[Condition | str] = Field(
        [], description="Under which it would then be a claim; before version 4, sentences."
    )
    tries: int = Field(ge=0, description="Hypotheses tried: records times routes.")
    threshold: Threshold | None
    message: Message | None
    derived_fraction: float | None = Field(description="Share of the registered model found in the suspect.")
    derived_but_unmarked: bool = Field(description="It equals the unmarked original to rounding, or a part of it.")
    derivation: Derivation | None = None
    transform: dict[str, Any] | None = Field(description="From suspect to registered model.")
    evidence: list[Evidence]
    layers: dict[Layer, float] | None = Field(
        None,
        description="z of tint and grain by themselves and of both; of pictures, also as read by the scatter of like"
        " chips; of Gaussians, also without a limit to what one chip says. The claim rests on the strongest.",
    )
    copy_z: float | None = Field(None, description="z of what tells this copy from others of the asset.")
    copy_named: bool | None = Field(None, description="Whether the suspect is this copy, or made from it.")
    regions: RegionCounts | None = Field(None, description="Where on the registered model it was found, as the map.")
    checks: list[Check]
    missing: str = Field(description="What an inconclusive answer lacks.")
    notes: list[str]
    pictures: dict[str, str] = Field(description="Name and SHA-256 of each picture of the report.")
    meaning: Meaning
    audit: Audit | None = Field(default=None, description="Always there in a signed document.")

    @model_validator(mode="after")
    def _of_its_version(self) -> ClaimDocument:
        new = self.schema_version >= DRAWN_BY_STAMP
        if any(isinstance(each, str) == new for each in self.conditions):
            raise ValueError(f"conditions have another form in version {self.schema_version}")
        if self.drawing is not None and not new:
            raise ValueError(f"version {self.schema_version} knows of no drawing")
        if self.acquisition is not None and not new:
            raise ValueError(f"version {self.schema_version} knows of no acquisition")
        return self


def _without_password(url: HttpUrl) -> HttpUrl:
    if url.username or url.password:
        raise ValueError("leave user name and password out of the address")
    return url


# All of it goes into the line of one GET: at most 14 kB where every letter of the note takes nine, of the server's 16.
Url = Annotated[HttpUrl, UrlConstraints(max_length=400), AfterValidator(_without_password)]
Note = Annotated[str, StringConstraints(max_length=1000)]


class OwnerStatement(BaseModel):
    """The owner's own statements. They are put into the pack as such, and kept nowhere."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    copy_url: list[Url] = Field([], max_length=10, description="Where the copy was found; repeatable.")
    original_url: Url | None = Field(None, description="Where the original is published.")
    law: Literal["dmca", "dsa"] | None = Field(
        None,
        description="Adds statement.txt: what 17 U.S.C. 512(c)(3)(A), or DSA article 16(2), asks for, and a list of the"
        " parts that are still blank.",
    )
    note: Note = Field("", description="Your own statement; shown apart from the finding.")
