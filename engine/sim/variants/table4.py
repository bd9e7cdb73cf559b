"""One row of the paper's Table 4 for any variant: quality without and with the mark, bits, claims.

The paper measures PSNR and LPIPS against ground truth. LPIPS needs a trained network; in its place stands
``1 - MS-SSIM``, a perceptual distance without one. Its numbers are **not** LPIPS and must not be set beside the
paper's column. Bits are read by informed extraction (with the owner's record); the paper's are not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from engine.errors import InputError
from engine.model import Float32
from engine.numerics.image_metrics import psnr
from engine.numerics.multiscale_ssim import ms_ssim_distance
from engine.pipeline.verification import Verification

__all__ = ["Reading", "VariantRow", "mark_psnr_for_drop", "measure_variant"]

LARGEST_DROP = 0.1
"""What a mark may cost against the truth, dB; the paper's costs 0.8 to 2.7."""


@dataclass(frozen=True)
class Reading:
    """What one verification of the variant said.

    Parameters
    ----------
    case : str
        The attack and the evidence, as the caller calls it: ``"none"``, ``"jpeg 10, one picture"``.
    route : str
        "model", "render" or "image": what the claim rests on.
    bit_accuracy : float
        Share of the message's bits read right, 0 to 1.
    z : float
        The claim statistic.
    log10_false_claim : float
        log10 of the bound on a false claim, tries counted.
    verdict : str
        "marked", "not_marked" or "inconclusive".
    """

    case: str
    route: str
    bit_accuracy: float
    z: float
    log10_false_claim: float
    verdict: str


@dataclass(frozen=True)
class VariantRow:
    """One row of Table 4.

    Parameters
    ----------
    name : str
        Of the variant.
    views : int
        Pictures measured on.
    psnr_before, psnr_after : float
        Mean over the views of the PSNR against the truth, dB, without and with the mark.
    distance_before, distance_after : float
        Mean over the views of 1 - MS-SSIM against the truth: 0 for equal pictures, 1 for unrelated ones.
    psnr_of_mark : float
        Worst view's PSNR of the marked against the unmarked variant, dB.
    readings : tuple of Reading
        In the order given; the first one is without attack.
    """

    name: str
    views: int
    psnr_before: float
    psnr_after: float
    distance_before: float
    distance_after: float
    psnr_of_mark: float
    readings: tuple[Reading, ...]

    @property
    def psnr_drop(self) -> float:
        """What the mark costs against the truth, dB; may be negative."""
        return self.psnr_before - self.psnr_after

    def to_json(self) -> dict[str, Any]:
        """Plain values; `psnr_drop` among them."""
        return {**asdict(self), "psnr_drop": self.psnr_drop}


def mark_psnr_for_drop(psnr_before: float, drop: float = LARGEST_DROP) -> float:
    """PSNR that the mark must keep against the unmarked variant to cost `drop` against the truth.

    The mark's chips are random signs, so its error is uncorrelated with the variant's own and squared errors add:
    ``10^(-after / 10) = 10^(-before / 10) + 10^(-mark / 10)``. The better a variant, the fainter its mark.

    Parameters
    ----------
    psnr_before : float
        Of the unmarked variant against the truth, dB.
    drop : float
        In (0, inf) dB.

    Returns
    -------
    float
        dB.

    Raises
    ------
    InputError
        If the drop is not positive.
    """
    if not drop > 0:
        raise InputError(f"a mark costs something: the drop must be positive, got {drop} dB")
    return psnr_before - 10.0 * math.log10(10.0 ** (drop / 10.0) - 1.0)


def measure_variant(
    name: str,
    truth: Sequence[Float32],
    before: Sequence[Float32],
    after: Sequence[Float32],
    readings: Mapping[str, Callable[[], Verification]],
) -> VariantRow:
    """Measure one variant as Table 4 does.

    It looks at pictures and claims only, so every variant renders, marks and attacks in its own way: a dynamic
    one shows several times, a codebook one reads its files back first.

    Parameters
    ----------
    name : str
        Of the variant.
    truth : sequence of (H, W, 3) float32
        Ground truth: photos, or renders of the model that the variant was made from. Range 0 to 1 once clipped,
        at least 176 pixels a side.
    before, after : sequence of (H, W, 3) float32
        The same views of the variant without and with the mark.
    readings : mapping of str to callable
        Case (attack and evidence) -> the verification of that suspect, run in this order; "none" comes first
        by custom.

    Returns
    -------
    VariantRow

    Raises
    ------
    InputError
        If there are no views, or not equally many of each.
    """
    if not truth or not len(truth) == len(before) == len(after):
        raise InputError(
            f"{name!r} needs equally many views of truth, before and after, got "
            f"{len(truth)}, {len(before)} and {len(after)}"
        )

    def mean(metric: Callable[[Float32, Float32], float], images: Sequence[Float32]) -> float:
        return float(np.mean([metric(a, b) for a, b in zip(truth, images, strict=True)]))

    return VariantRow(
        name=name,
        views=len(truth),
        psnr_before=mean(psnr, before),
        psnr_after=mean(psnr, after),
        distance_before=mean(ms_ssim_distance, before),
        distance_after=mean(ms_ssim_distance, after),
        psnr_of_mark=min(psnr(a, b) for a, b in zip(before, after, strict=True)),
        readings=tuple(_read(case, verify()) for case, verify in readings.items()),
    )


def _read(case: str, verification: Verification) -> Reading:
    claim = verification.claim
    return Reading(
        case, claim.route, claim.bit_accuracy, claim.z, claim.log10_false_claim, claim.verdict.value
    )
