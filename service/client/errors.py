"""The one error of the client: the service's problem, or that it could not be reached."""

from collections.abc import Mapping
from typing import Any

TYPE_PREFIX = "urn:mark3dgs:problem:"
_MEMBERS = {"type", "title", "status", "detail", "request_id"}


class ServiceError(Exception):
    """What went wrong, as the service says it (problem+json, RFC 9457) or as it looks from here.

    Attributes
    ----------
    code : str
        Last part of the problem's `type`, which never changes its meaning. From here: "unreachable" (no answer came),
        "unexpected-answer" (none of this API's), "timed-out" (a job has not ended yet), "disputed" (a model carries
        another's mark and was not marked again), "cancelled" (the job was), "changed" (a file did, while it was sent),
        "untrusted" (a webhook's message).
    detail : str
        What is wrong, with the offending value.
    status : int
        Of the answer; of a job's problem, what the service would have answered. 0 from here.
    values : mapping
        Further members of the problem: `errors` (place and text of each invalid value), `offset`, `wanted`, `job`, ...
    request_id : str
        Under which the service's log has it.
    retry_after : float or None
        Seconds after which the service takes the request again, where it said so.
    """

    def __init__(
        self,
        code: str,
        detail: str,
        *,
        status: int = 0,
        values: Mapping[str, Any] | None = None,
        request_id: str = "",
        retry_after: float | None = None,
    ) -> None:
        super().__init__(f"{code}: {detail}")
        self.code, self.detail, self.status = code, detail, status
        self.values, self.request_id, self.retry_after = dict(values or {}), request_id, retry_after


def of_problem(plain: Mapping[str, Any], retry_after: float | None = None, **values: Any) -> ServiceError:
    """The error of a problem object; KeyError, TypeError or ValueError where it is none."""
    return ServiceError(
        str(plain["type"]).removeprefix(TYPE_PREFIX),
        str(plain["detail"]),
        status=int(plain["status"]),
        values={name: value for name, value in plain.items() if name not in _MEMBERS} | values,
        request_id=str(plain.get("request_id", "")),
        retry_after=retry_after,
    )
