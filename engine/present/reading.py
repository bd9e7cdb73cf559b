"""The reading of one registered mark in one suspect: the result of `verify`, alike on command line, API and page."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from engine.numerics.plain import Report
from engine.present.wording import COIN, headline_of, why_no_bits

__all__ = ["Bits", "Reading", "reading_of"]

UNREAD = "?"


@dataclass(frozen=True)
class Bits:
    """A payload, most significant bit first."""

    string: str  # of 0 and 1, and ? for a bit of which nothing was read
    hex: str | None  # None where a bit was not read


@dataclass(frozen=True)
class Reading(Report):
    """Verdict, bits, and how sure both are.

    Detection is informed: the owner's record and key say where the bits are and which were embedded. The verdict rests
    on how clearly all bits were read together, not on how many of them match.
    """

    verdict: str  # marked, not_marked or inconclusive
    headline: str  # the verdict in two or three words
    bits: Bits | None  # as extracted; None where nothing was read
    no_bits: str | None  # why there are none
    registered_bits: Bits | None  # as the record has them; None without a record
    matching: int | None  # of the bits that were read, how many are as registered
    bit_accuracy: float | None  # matching / length; pure chance gives about 0.5
    reliability: list[float] | None  # of each bit, the probability that it was read correctly; 0.5 is chance
    z: float | None  # detection statistic; 0 +- 1 without a mark
    hypotheses: int  # tested in this verification; every bound counts them
    log10_false_claim: float  # upper bound on the probability that an unrelated key scores this high, log10
    # -log2 of that bound, in bits. A claim needs 30 (1 in 10^9) where a time-stamping service drew a part of the
    # watermark, else 128
    strength: float
    # 1 - that bound; 0 is no evidence, and from a strength of 53 on it rounds to 1.0. It is not the probability that
    # the suspect is marked
    confidence: float
    derived_fraction: float | None  # share of the registered model found in the suspect; None where not measured


def reading_of(claim: Mapping[str, Any], registered: str | None) -> Reading:
    """The reading of a claim.

    Parameters
    ----------
    claim : mapping
        Members of `Claim.to_json`; `message` and `z` are None where no record could be compared.
    registered : str or None
        The registered payload, hexadecimal; None without a record.
    """
    no_bits = why_no_bits(claim)
    meant, read, sure = (_bits(registered) if registered else None), None, None
    matching = accuracy = None
    if meant is not None and no_bits is None:
        sure = [float(each) for each in claim["bit_reliability"]]
        read = _bits(claim["message"], sure)
        matching = sum(a == b for a, b in zip(read.string, meant.string, strict=True))
        accuracy = matching / len(sure)
    return Reading(
        verdict=str(claim["verdict"]),
        headline=headline_of(claim),
        bits=read,
        no_bits=no_bits,
        registered_bits=meant,
        matching=matching,
        bit_accuracy=accuracy,
        reliability=sure,
        z=claim["z"],
        hypotheses=claim["tries"],
        log10_false_claim=claim["log10_false_claim"],
        strength=max(0.0, -claim["log10_false_claim"] / math.log10(2.0)),
        confidence=claim["confidence"],
        derived_fraction=claim["derived_fraction"],
    )


def _bits(text: str, reliability: Sequence[float] = ()) -> Bits:
    """Bits of a hexadecimal payload; those that are no surer than a coin stay open."""
    digits = "".join(f"{byte:08b}" for byte in bytes.fromhex(text))
    read = digits
    if reliability:
        read = "".join(digit if sure > COIN else UNREAD for digit, sure in zip(digits, reliability, strict=True))
    return Bits(read, None if UNREAD in read else text)
