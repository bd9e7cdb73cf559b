"""Numbers with their intervals, in words."""

from collections.abc import Sequence
from dataclasses import dataclass

from engine.evaluate.intervals import bootstrap, share_interval
from engine.evaluate.study import Row

__all__ = ["INTERVALS", "Accuracy", "accuracy", "mean_text", "range_text"]

INTERVALS = (
    "Shares of bits carry exact 95 % intervals over all bits read (Clopper and Pearson). The bits of one reading "
    "are not independent, so that interval is too narrow; the exact one of the readings without a single wrong "
    "bit stands beside it and assumes only that readings are independent."
)


@dataclass(frozen=True)
class Accuracy:
    """Bits of several readings.

    Parameters
    ----------
    share : float
        Of all bits, read right, 0 to 1.
    low, high : float
        Exact interval over bits.
    readings, whole : int
        How many, and how many without a wrong bit.
    whole_low : float
        Lower end of the exact interval of that share.
    """

    share: float
    low: float
    high: float
    readings: int
    whole: int
    whole_low: float

    def __str__(self) -> str:
        return (
            f"{100 * self.share:.2f} % ({100 * self.low:.2f} to {100 * self.high:.2f}); "
            f"{self.whole} of {self.readings} readings whole (at least {100 * self.whole_low:.0f} %)"
        )


def accuracy(rows: Sequence[Row], right: str = "right") -> Accuracy | None:
    """Of rows with ``right`` and ``bits``; None without rows."""
    if not rows:
        return None
    bits, hits = sum(row["bits"] for row in rows), sum(row[right] for row in rows)
    whole = sum(row[right] == row["bits"] for row in rows)
    return Accuracy(hits / bits, *share_interval(hits, bits), len(rows), whole, share_interval(whole, len(rows))[0])


def mean_text(values: Sequence[float], digits: int = 1) -> str:
    """Mean with a bootstrap interval over the values; one value alone is said to be alone."""
    if not values:
        return ""
    mean = sum(values) / len(values)
    if len(values) == 1:
        return f"{mean:.{digits}f} (one)"
    low, high = bootstrap(values)
    return f"{mean:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def range_text(values: Sequence[float], digits: int = 0) -> str:
    """Least and most."""
    if not values:
        return ""
    low, high = f"{min(values):.{digits}f}", f"{max(values):.{digits}f}"
    return low if low == high else f"{low} to {high}"
