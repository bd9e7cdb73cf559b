"""Results of jobs, in the API's description. The result of an earlier version's job is passed on unchanged."""

import json
import math
from typing import (
    Annotated,
    Any,
    Literal,
    NotRequired,  # pydantic wants these before Python 3.12
)

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, JsonValue, with_config
from typing_extensions import TypedDict

Time = Annotated[str, Field(json_schema_extra={"format": "date-time"})]
"""UTC, ISO 8601."""

TimeOrNot = Annotated[Time | None, BeforeValidator(lambda text: text or None)]
"""null while it has not come; rows and jobs say "" then."""


_EMBEDDED: JsonValue = {
    "asset_id": "as_d40313a36c48f4baf73fb30a",
    "record_id": "3871513a0d27461d362f21a8244218b9",
    "message": "8be81eaf",
    "gaussians": 113648,
    "psnr_worst_view": 47.04,
    "psnr_total_worst_view": 47.04,
    "psnr_as_written": 46.31,
    "ssim_worst_view": 0.9985,
    "seconds": 10.5,
    "already_carries": [],
    "not_screened": 0,
    "review": "Registered. ...",
}
_READING: dict[str, JsonValue] = {
    "verdict": "marked",
    "headline": "Watermark found",
    "bits": {"string": "1000101111101000", "hex": "8be8"},
    "no_bits": None,
    "registered_bits": {"string": "1000101111101000", "hex": "8be8"},
    "matching": 16,
    "bit_accuracy": 1.0,
    "reliability": [0.9999] * 16,
    "z": 118.9,
    "hypotheses": 2,
    "log10_false_claim": -3067.5,
    "strength": 10190.0,
    "confidence": 1.0,
    "derived_fraction": 1.0,
}
_CLAIM_ID, _ASSET_ID = "cl_f6b2ce7c59a1e745e1b7d86e", "as_d40313a36c48f4baf73fb30a"
_VERIFIED: JsonValue = {
    **_READING,
    "claim_id": _CLAIM_ID,
    "asset_id": _ASSET_ID,
    "checks": [{"code": "record_intact", "ok": True, "text": "The record is whole and unaltered."}],
    "others": [],
    "links": {"claim": f"/v1/claims/{_CLAIM_ID}", "asset": f"/v1/assets/{_ASSET_ID}"},
}


@with_config(ConfigDict(extra="forbid", json_schema_extra={"examples": [_EMBEDDED]}))
class EmbedResult(TypedDict):
    """Result of an embedding."""

    asset_id: str
    record_id: str
    message: Annotated[str, Field(description="The registered bits, hexadecimal.")]
    gaussians: int
    psnr_worst_view: Annotated[float, Field(description="dB of the watermark alone, without pruning; worst key view.")]
    psnr_total_worst_view: NotRequired[  # a step of before has none
        Annotated[float, Field(description="dB against the original, with pruning (`budget`); worst key view.")]
    ]
    psnr_as_written: NotRequired[
        Annotated[float, Field(description="The same of the file read back, in that view: with a format's rounding.")]
    ]
    ssim_worst_view: Annotated[float, Field(description="Of the watermark alone; worst key view.")]
    seconds: float
    already_carries: Annotated[list[str], Field(description="Assets of yours whose mark the model carried before.")]
    not_screened: Annotated[int, Field(description="Similar copies of yours, too many to check all: not checked.")]
    review: Annotated[str, Field(description="What follows the registration; the same text for every upload.")]


@with_config(ConfigDict(extra="forbid"))
class CheckResult(TypedDict):
    """One thing that was checked; `ok` is null where it could not be."""

    code: str
    ok: bool | None
    text: str


@with_config(ConfigDict(extra="forbid"))
class Bits(TypedDict):
    """A payload, most significant bit first."""

    string: Annotated[str, Field(pattern="^[01?]+$", description="0 and 1; ? where nothing of a bit was read.")]
    hex: Annotated[str | None, Field(description="null where a bit was not read.")]


@with_config(ConfigDict(extra="forbid", json_schema_extra={"examples": [_READING]}))
class Reading(TypedDict):
    """The reading of one registered mark in the suspect; `mark3dgs verify --json` has the same members.

    Detection is informed: the owner's record and key say where the bits are, and which were embedded. The verdict rests
    on how clearly all bits were read together, not on how many match.
    """

    verdict: Literal["marked", "not_marked", "inconclusive"]
    headline: Annotated[str, Field(description="The verdict in words.")]
    bits: Annotated[Bits | None, Field(description="As extracted; null where nothing was read.")]
    no_bits: NotRequired[Annotated[str | None, Field(description="Why there are none.")]]
    registered_bits: Annotated[Bits | None, Field(description="As the record has them.")]
    matching: Annotated[int | None, Field(description="Bits that were read as registered.")]
    bit_accuracy: Annotated[float | None, Field(description="matching / length; pure chance gives about 0.5.")]
    reliability: Annotated[list[float] | None, Field(description="Per bit: probability that it is correct.")]
    z: Annotated[float | None, Field(description="Detection statistic; 0 +- 1 without a mark.")]
    hypotheses: Annotated[int, Field(description="Hypotheses tested; every bound is corrected for them.")]
    log10_false_claim: Annotated[
        float, Field(description="log10 of the upper bound on the probability that an unrelated key scores this high.")
    ]
    strength: Annotated[
        float,
        Field(ge=0, description="-log2 of that bound, in bits: 30 is 1 in 10^9; 128 is needed if no time stamp drew."),
    ]
    confidence: Annotated[
        float, Field(description="1 - that bound; rounds to 1.0 from strength 53 on. Not the probability of a mark.")
    ]
    derived_fraction: Annotated[float | None, Field(description="Share of the registered model in the suspect.")]


@with_config(ConfigDict(extra="forbid"))
class AssetReading(Reading):
    """The reading of another asset."""

    asset_id: str
    copy_name: str


@with_config(ConfigDict(extra="forbid", json_schema_extra={"examples": [_VERIFIED]}))
class VerifyResult(Reading):
    """Result of a verification: the readings of the asset with the strongest evidence, and of others."""

    claim_id: str
    asset_id: Annotated[str | None, Field(description="null where no asset was recognised.")]
    checks: list[CheckResult]
    others: Annotated[list[AssetReading], Field(description="Other assets that were recognised, at most 20.")]
    links: Annotated[dict[str, str], Field(description="claim, jws, report, annex; asset; pack, where there is one.")]
    timestamp_failure: NotRequired[Annotated[str, Field(description="Why there is no time stamp.")]]


@with_config(ConfigDict(extra="forbid"))
class DisputeResult(TypedDict):
    """Result of a settled dispute."""

    dispute_id: str
    first: Annotated[str, Field(description="Who came first: a, b, or why that cannot be decided.")]
    document: Annotated[dict[str, Any], Field(description="What is signed (see docs/CLAIM.md).")]
    jws: str


Earlier = Annotated[dict[str, Any], Field(title="Earlier result", description="Result of an earlier version's job.")]
Result = Annotated[EmbedResult | VerifyResult | DisputeResult | Earlier | None, Field(union_mode="left_to_right")]


@with_config(ConfigDict(extra="allow"))
class Failure(TypedDict):
    """Why a job failed: a problem (RFC 9457), with the numbers that failed as further members."""

    type: str
    title: str
    status: int
    detail: str


@with_config(ConfigDict(extra="allow"))
class FileInfo(TypedDict):
    """What an uploaded file is, as far as it was inspected."""

    kind: Literal["model", "picture", "cameras"]
    format: NotRequired[str]
    gaussians: NotRequired[int]
    sh_degree: NotRequired[int]
    repairs: NotRequired[list[dict[str, Any]]]
    width: NotRequired[int]
    height: NotRequired[int]
    cameras: NotRequired[int]


class Notice(BaseModel):
    """A mark of yours in what another account uploaded to be marked."""

    id: str
    asset_id: str = Field(description="Your asset whose mark was found; of several copies, the clearest one.")
    copy_named: bool | None = Field(description="Whether the upload is that copy; null where copies do not differ.")
    z: float = Field(description="Detection statistic; 0 +- 1 without a mark.")
    log10_false_claim: float = Field(description="log10 of the false-claim bound, corrected for all hypotheses.")
    strength: float = Field(description="-log2 of that bound, in bits.")
    uploaded_as: str = Field(description="Asset that the upload became, for a dispute (POST /v1/disputes).")
    created_at: Time


def notice_of(row: Any) -> Notice:
    """What a row of `notices` says."""
    found = json.loads(row.finding)
    finding = {name: found[name] for name in ("z", "log10_false_claim", "copy_named")}
    strength = -found["log10_false_claim"] / math.log10(2.0)
    about = {"asset_id": row.asset, "uploaded_as": row.upload, "created_at": row.created_at}
    return Notice(id=row.id, strength=strength, **finding, **about)
