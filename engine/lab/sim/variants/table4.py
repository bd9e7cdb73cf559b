"""One row of the paper's Table 4 for any variant: quality without and with the mark, bits, claims.

The paper measures PSNR and LPIPS against ground truth. LPIPS needs a trained network; in its place stands
``1 - MS-SSIM``, a perceptual distance without one. Its numbers are **not** LPIPS and must not be set beside the
paper's column. Bits are read by informed extraction (with the owner's record); the paper's are not.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from engine.errors import InputError
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.verify.verification import Verification, VerifyConfig, verify_images, verify_model
from engine.lab.sim.attacks import image_attack, model_attack
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.image_metrics import ms_ssim_distance, psnr
from engine.raster import RasterSettings, render

__all__ = ["Cases", "Reading", "Readings", "Suspect", "VariantRow", "fidelity_for", "measure_variant"]

DROP_DB = 0.09
"""What a mark is planned to cost against the truth; the bar is 0.1, new views fare worse than key views."""

Readings = dict[str, Callable[[], Verification]]
"""Case (attack and evidence) -> the verification of that suspect."""

Cases = tuple[tuple[str, str, float | str], ...]
"""What a row calls it, attack and strength."""

MODEL_CASES: Cases = (
    ("clone 0.5", "clone", 0.5),
    ("prune_random 0.2", "prune_random", 0.2),
    ("crop 0.1", "crop", 0.1),
    ("noise_all 0.1", "noise_all", 0.1),
    ("similarity 2.0", "similarity", 2.0),
    ("quantize 8", "quantize", 8),
    ("convert splat", "convert", "splat"),
    ("convert sog", "convert", "sog"),
)
"""On the marked variant as plain Gaussians."""
PICTURE_CASES: Cases = (
    ("picture, jpeg 10", "jpeg", 10.0),
    ("picture, noise_image 0.1", "noise_image", 0.1),
    ("picture, rotate_image 30", "rotate_image", 30.0),
    ("picture, crop_image 0.4", "crop_image", 0.4),
    ("picture, scale_image 0.75", "scale_image", 0.75),
)
"""On one picture of the marked variant, its camera known."""
DISC_MODEL_CASES: Cases = (
    ("clone 50 %", "clone", 0.5),
    ("prune random 50 %", "prune_random", 0.5),
    ("crop to 10 %", "crop", 0.1),
    ("noise 0.1 on all", "noise_all", 0.1),
    ("SH cut to degree 0", "drop_sh", 0),
    ("quantised to 8 bits", "quantize", 8),
    (".spz and back", "convert", "spz"),
    (".sog and back", "convert", "sog"),
)
DISC_PICTURE_CASES: Cases = (
    ("one picture, JPEG 10", "jpeg", 10.0),
    ("one picture, noise 0.1", "noise_image", 0.1),
    ("one picture, rotation 30", "rotate_image", 30.0),
    ("one picture, crop 40 % of the area", "crop_image", 0.4),
)


@dataclass(frozen=True)
class Reading:
    """What one verification of the variant said."""

    case: str  # the attack and the evidence, as the caller calls it: ``"none"``, ``"jpeg 10, one picture"``
    route: str  # "model", "render" or "image": what the claim rests on
    bit_accuracy: float  # share of the message's bits read right, 0 to 1
    z: float
    log10_false_claim: float  # log10 of the bound on a false claim, tries counted
    verdict: str  # "marked", "not_marked" or "inconclusive"


@dataclass(frozen=True)
class VariantRow:
    """One row of Table 4."""

    name: str
    views: int  # pictures measured on
    psnr_before: float  # mean over the views against the truth, dB, without the mark
    psnr_after: float  # with it
    distance_before: float  # mean of 1 - MS-SSIM against the truth: 0 for equal pictures, 1 for unrelated ones
    distance_after: float
    psnr_of_mark: float  # worst view's PSNR of the marked against the unmarked variant, dB
    readings: tuple[Reading, ...]  # in the order given; the first one is without attack

    @property
    def psnr_drop(self) -> float:
        """What the mark costs against the truth, dB; may be negative."""
        return self.psnr_before - self.psnr_after

    def to_json(self) -> dict[str, Any]:
        """Plain values; `psnr_drop` among them."""
        return {**asdict(self), "psnr_drop": self.psnr_drop}


@dataclass(frozen=True, eq=False)
class Suspect:
    """A marked variant as plain Gaussians, its pictures, and the record it is read with."""

    marked: GaussianModel
    pictures: list[Float32]
    cameras: Sequence[Camera]
    opened: OpenedRecord
    seed: int

    def read_model(self, attack: str = "", strength: float | str = 0.0, route: str = "auto") -> Verification:
        suspect = self.marked
        if attack:
            suspect = model_attack(attack).apply(suspect, strength, rng=self.seed)
        return verify_model(suspect, self.opened, VerifyConfig(route=route))

    def read_picture(
        self, attack: str = "", strength: float | str = 0.0, view: int = 0, known: bool = True
    ) -> Verification:
        picture = self.pictures[view]
        if attack:
            picture = image_attack(attack).apply(picture, strength, rng=self.seed)
        return verify_images([picture], self.opened, cameras=[self.cameras[view]] if known else None)

    def read_thin(self) -> Verification:
        """The first picture, its discs drawn as thin Gaussians as a 3DGS viewer does."""
        thin = RasterSettings(kernel="gaussian")
        picture = np.clip(render(self.marked, self.cameras[0], settings=thin), 0.0, 1.0)
        return verify_images([picture], self.opened, cameras=self.cameras[:1])

    def attacked_models(self, cases: Cases, route: str = "auto") -> Readings:
        return {case: partial(self.read_model, name, strength, route) for case, name, strength in cases}

    def attacked_pictures(self, cases: Cases) -> Readings:
        return {case: partial(self.read_picture, name, strength) for case, name, strength in cases}


def fidelity_for(truth: Sequence[Float32], before: Sequence[Float32], least: float, drop: float = DROP_DB) -> float:
    """PSNR (dB, steps of a half, `least` at least) at which a mark costs no more than `drop` dB against the truth.

    The better a variant is, the finer its mark must be: errors add up in power where they do not know of each
    other, so a view at b dB falls by 10 log10(1 + 10^((b - m) / 10)) under a mark at m dB. The mean over the views
    counts; truth and the unmarked variant are pictures (H, W, 3).
    """
    base = np.array([psnr(a, b) for a, b in zip(truth, before, strict=True)])
    if not np.isfinite(base).all():
        raise InputError("the variant equals its truth: any mark at all costs more than a given drop")
    mark = least
    while np.mean(10 * np.log10(1 + 10 ** ((base - mark) / 10))) > drop:
        mark += 0.5
    return mark


def measure_variant(
    name: str,
    truth: Sequence[Float32],
    before: Sequence[Float32],
    after: Sequence[Float32],
    readings: Mapping[str, Callable[[], Verification]],
) -> VariantRow:
    """Measure one variant as Table 4 does, from pictures and claims only: it renders, marks and attacks in its own way.

    `truth`, `before` and `after` are the same views (H, W, 3), at least 176 pixels a side: ground truth (photos, or
    renders of the model that the variant was made from), the variant without and with the mark. The `readings` run in
    their order; "none" comes first by custom. InputError if there are no views, or not equally many of each.
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
    return Reading(case, claim.route, claim.bit_accuracy, claim.z, claim.log10_false_claim, claim.verdict.value)
