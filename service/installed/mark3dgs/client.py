"""The client of the service under the name that its users know; `service.client` has the code."""

from service.client import (
    Asset,
    AsyncClient,
    Check,
    Claim,
    ClaimSummary,
    Client,
    Embedded,
    Job,
    Me,
    ServiceError,
    Share,
    Upload,
    Verified,
)

__all__ = [
    "Asset",
    "AsyncClient",
    "Check",
    "Claim",
    "ClaimSummary",
    "Client",
    "Embedded",
    "Job",
    "Me",
    "ServiceError",
    "Share",
    "Upload",
    "Verified",
]
