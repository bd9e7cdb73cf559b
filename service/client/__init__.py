"""A client of the service, on httpx alone: it knows neither the service's code nor the engine.

Installed, it is `mark3dgs.client`. Start at `calls` and `downloads` (what it can do); `wire` sends, and says what is
sent again.
"""

from service.client.answers import (
    Acquisition,
    Asset,
    AssetReading,
    Bits,
    Check,
    Claim,
    ClaimSummary,
    Condition,
    Embedded,
    Event,
    Job,
    Me,
    Notice,
    Reading,
    Share,
    Upload,
    Verified,
    Webhook,
)
from service.client.downloads import Client
from service.client.errors import ServiceError
from service.client.webhooks import check_webhook

__all__ = [
    "Acquisition",
    "Asset",
    "AssetReading",
    "Bits",
    "Check",
    "Claim",
    "ClaimSummary",
    "Client",
    "Condition",
    "Embedded",
    "Event",
    "Job",
    "Me",
    "Notice",
    "Reading",
    "ServiceError",
    "Share",
    "Upload",
    "Verified",
    "Webhook",
    "check_webhook",
]
