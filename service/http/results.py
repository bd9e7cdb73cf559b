"""What jobs come to, in the API's description. What an earlier version's job came to passes as it is."""

from typing import (
    Annotated,
    Any,
    Literal,
    NotRequired,  # pydantic wants these before Python 3.12
)

from pydantic import BeforeValidator, ConfigDict, Field, JsonValue, with_config
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
    "ssim_worst_view": 0.9985,
    "seconds": 10.5,
    "already_carries": [],
    "not_screened": 0,
}
_VERIFIED: JsonValue = {
    "claim_id": "cl_f6b2ce7c59a1e745e1b7d86e",
    "asset_id": "as_d40313a36c48f4baf73fb30a",
    "verdict": "marked",
    "confidence": 1.0,
    "log10_false_claim": -3067.5,
    "checks": [{"code": "record_intact", "ok": True, "text": "The record is whole and unaltered."}],
}


@with_config(ConfigDict(extra="forbid", json_schema_extra={"examples": [_EMBEDDED]}))
class EmbedResult(TypedDict):
    """Of a model that was marked."""

    asset_id: str
    record_id: str
    message: Annotated[str, Field(description="The registered bits, hexadecimal.")]
    gaussians: int
    psnr_worst_view: Annotated[float, Field(description="dB, against the unmarked render.")]
    ssim_worst_view: float
    seconds: float
    already_carries: Annotated[list[str], Field(description="Assets of yours whose mark the model carried before.")]
    not_screened: Annotated[int, Field(description="Similar copies, too many to check all: so many were not.")]


@with_config(ConfigDict(extra="forbid"))
class DisputedResult(TypedDict):
    """Of a model that carries another's mark, and was not marked again."""

    text: str


@with_config(ConfigDict(extra="forbid"))
class CheckResult(TypedDict):
    """One thing that was checked; `ok` is null where it could not be."""

    code: str
    ok: bool | None
    text: str


@with_config(ConfigDict(extra="forbid", json_schema_extra={"examples": [_VERIFIED]}))
class VerifyResult(TypedDict):
    """Of a suspect that was checked; the claim says all of it."""

    claim_id: str
    asset_id: Annotated[str | None, Field(description="null where none of all was recognised.")]
    verdict: Literal["marked", "not_marked", "inconclusive"]
    confidence: Annotated[float, Field(description="1 - min(1, bound); not the probability that it is marked.")]
    log10_false_claim: Annotated[float, Field(description="Of the bound on a false claim, all tries counted.")]
    checks: list[CheckResult]
    timestamp_failure: NotRequired[Annotated[str, Field(description="Why there is no time stamp.")]]


@with_config(ConfigDict(extra="forbid"))
class DisputeResult(TypedDict):
    """Of a dispute that was settled."""

    dispute_id: str
    first: Annotated[str, Field(description="Who came first: a, b, or why that cannot be decided.")]
    document: Annotated[dict[str, Any], Field(description="What is signed (see docs/CLAIM.md).")]
    jws: str


Earlier = Annotated[dict[str, Any], Field(title="Earlier result", description="Of an earlier version's job.")]
Result = Annotated[
    EmbedResult | VerifyResult | DisputeResult | DisputedResult | Earlier | None, Field(union_mode="left_to_right")
]


@with_config(ConfigDict(extra="allow"))
class Failure(TypedDict):
    """Why a job failed: a problem (RFC 9457), with the numbers that failed as further members."""

    type: str
    title: str
    status: int
    detail: str


@with_config(ConfigDict(extra="allow"))
class FileInfo(TypedDict):
    """What an uploaded file is, as far as was looked."""

    kind: Literal["model", "picture", "cameras"]
    format: NotRequired[str]
    gaussians: NotRequired[int]
    sh_degree: NotRequired[int]
    repairs: NotRequired[list[dict[str, Any]]]
    width: NotRequired[int]
    height: NotRequired[int]
    cameras: NotRequired[int]
