"""The client of the service under the name that its users know; `service.client` has the code."""

from service.client import (
    Asset,
    AsyncClient,
    Check,
    Claim,
    ClaimSummary,
    Client,
    Embedded,
    Event,
    Job,
    Me,
    ServiceError,
    Share,
    Upload,
    Verified,
    Webhook,
    check_webhook,
)

__all__ = [
    "Asset",
    "AsyncClient",
    "Check",
    "Claim",
    "ClaimSummary",
    "Client",
    "Embedded",
    "Event",
    "Job",
    "Me",
    "ServiceError",
    "Share",
    "Upload",
    "Verified",
    "Webhook",
    "check_webhook",
]
