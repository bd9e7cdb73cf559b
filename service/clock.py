"""Times as this service writes them, and who vouches for them."""

from datetime import UTC, datetime, timedelta

LOG = "the log of this service"
"""Who attests registrations here."""


def now() -> str:
    """UTC, ISO 8601 with microseconds: sorts as text."""
    return datetime.now(UTC).isoformat(timespec="microseconds")


def ago(hours: float) -> str:
    """The time that many hours before now; after now where `hours` is negative."""
    return (datetime.now(UTC) - timedelta(hours=hours)).isoformat(timespec="microseconds")


def seconds_until(time: str) -> float:
    """From now; 0 once it is past."""
    if time <= now():
        return 0.0
    return (datetime.fromisoformat(time) - datetime.now(UTC)).total_seconds()
