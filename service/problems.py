"""Errors as the API says them: problem+json (RFC 9457) with a stable `type`."""

from collections.abc import Mapping
from typing import Any

from engine.errors import Mark3DGSError

TYPE_PREFIX = "urn:mark3dgs:problem:"
MEDIA_TYPE = "application/problem+json"

KINDS: dict[str, tuple[int, str]] = {
    "malformed-request": (400, "The request cannot be read"),
    "unauthorized": (401, "An API key is needed"),
    "forbidden": (403, "This API key may not do that"),
    "not-found": (404, "Not found"),
    "method-not-allowed": (405, "Method not allowed"),
    "too-slow": (408, "The body arrived too slowly"),
    "conflict": (409, "Conflict with the present state"),
    "request-in-flight": (409, "A request with this Idempotency-Key is in progress"),
    "length-required": (411, "Content-Length is required"),
    "too-large": (413, "Too large"),
    "quota-exceeded": (413, "This tenant's storage is used up"),
    "unsupported-media-type": (415, "This content type is not supported"),
    "range-not-satisfiable": (416, "The range is outside the file"),
    "invalid-request": (422, "A value is not valid"),
    "unreadable-model": (422, "The model cannot be read"),
    "unreadable-image": (422, "The picture cannot be read"),
    "unreadable-cameras": (422, "The cameras cannot be read"),
    "capacity": (422, "The scene cannot carry this message"),
    "idempotency-mismatch": (422, "This Idempotency-Key was used with another body"),
    "digest-mismatch": (422, "The bytes do not match their announced digest"),
    "budget-exceeded": (429, "Too many requests"),
    "internal": (500, "Internal server error"),
    "engine-limit": (500, "The work exceeded its limits"),
    "storage-full": (507, "No space left"),
    "not-fetched": (502, "The address could not be fetched"),
    "no-time-stamp": (502, "The time-stamping service gave no valid stamp"),
    "unavailable": (503, "A part of the service is not available"),
}
"""Kind -> (HTTP status, title). The kind is the last part of `type` and never changes its meaning."""


class Problem(Mark3DGSError):
    """An error that the client receives: `kind` is a key of KINDS, `detail` what is wrong, with the offending value.

    `headers` are of the response, such as Retry-After; `extra` are further members of the problem object.
    """

    def __init__(self, kind: str, detail: str, *, headers: Mapping[str, str] | None = None, **extra: Any) -> None:
        self.status, self.title = KINDS[kind]
        self.kind, self.detail, self.headers, self.extra = kind, detail, dict(headers or {}), extra
        super().__init__(detail)

    def to_json(self, request_id: str = "") -> dict[str, Any]:
        """The problem object."""
        plain = {
            "type": TYPE_PREFIX + self.kind,
            "title": self.title,
            "status": self.status,
            "detail": self.detail,
            **self.extra,
        }
        return plain | {"request_id": request_id} if request_id else plain


def from_json(plain: Mapping[str, Any]) -> Problem:
    """A problem that was stored with `to_json`."""
    known = {"type", "title", "status", "detail", "request_id"}
    kind = str(plain["type"]).removeprefix(TYPE_PREFIX)
    return Problem(kind, str(plain["detail"]), **{k: v for k, v in plain.items() if k not in known})
