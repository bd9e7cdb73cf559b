"""Rows of the paper's Table 4 for any variant: quality without and with the mark, bits, claims.

The paper measures PSNR and LPIPS against ground truth. LPIPS needs a trained network; in its place stands
``1 - MS-SSIM``, a perceptual distance without one. Its numbers are **not** LPIPS and must not be compared with the
paper's column. Bits are read by informed extraction (with the owner's record); the paper's are not. Each variant
goes through its own files before the mark and after it.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from engine.errors import InputError
from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import EmbedConfig
from engine.flows.embed.terms import MarkTerms
from engine.flows.records.opened_record import OpenedRecord, open_record
from engine.flows.verify.search import Verification, VerifyConfig, verify_images, verify_model
from engine.flows.views.camera_rig import make_rig
from engine.formats import encode_model, read_model
from engine.formats.file_writing import write_whole
from engine.lab.sim.attacks import image_attack, model_attack
from engine.lab.sim.multiscale_ssim import ms_ssim_distance
from engine.lab.sim.variants.generative import mark_generated, write_raw_ply
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.image_metrics import psnr
from engine.raster import RasterSettings, render
from engine.scenes.clip_marking import embed_moving, move_record, verify_moment, verify_moving_images, visible
from engine.scenes.codebook_files import PLY, read_codebook, write_codebook
from engine.scenes.codebook_model import CodebookModel
from engine.scenes.scene_marking import embed_codebook
from engine.scenes.spacetime import SpacetimeModel
from engine.scenes.spacetime_ply import read_spacetime_ply, write_spacetime_ply
from engine.watermark.keys import OwnerKey
from engine.watermark.rates import MADE_FIRST

DROP_DB = 0.09  # what a mark is planned to cost against the truth; the bar is 0.1, new views fare worse than key views

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
    ("quantized to 8 bits", "quantize", 8),
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


BITS = 32  # of the message
VIEWS, SIZE = 6, 512  # views measured on, and their side in pixels
TIMES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Moments of a clip at which it is looked at, one view each; the middle one is attacked."""
SEARCHED_MOMENTS = 5  # moments that are tried where the time of a picture is unknown


class _Truth(Protocol):
    def at(self, time: float) -> GaussianModel: ...


def measure_discs(
    original: GaussianModel,
    discs: GaussianModel,
    key: OwnerKey,
    config: EmbedConfig,
    *,
    views: int = VIEWS,
    size: int = SIZE,
    seed: int = 0,
) -> VariantRow:
    """Mark discs and fill their row; their own file is a PLY with two scales.

    Renders of the `original`, which they were made from, are the truth. The config's fidelity is raised as far as
    `fidelity_for` asks. It is measured on `views` that neither mark nor fit has seen, `size` pixels a side; `seed` is
    that of the views and the attacks.

    Evidence from the model, also after `DISC_MODEL_CASES`; from renders of the suspect at the pose key; from one
    picture, also drawn as thin Gaussians and after `DISC_PICTURE_CASES`; and from one whose camera is not known, where
    the record has landmarks (``landmark_views``).
    """
    if not discs.is_flat:
        raise InputError("a 2DGS model has two scales, this one has three")
    file = encode_model(discs, "ply")
    discs = read_model(file).model

    def mark(finer: EmbedConfig) -> tuple[GaussianModel, OpenedRecord]:
        result = embed(discs, key, original_sha256=hashlib.sha256(file).hexdigest(), bits=BITS, config=finer)
        delivered = read_model(encode_model(result.model, "ply")).model
        return delivered, open_record(result.record.to_bytes(key), key, MADE_FIRST)

    def read(suspect: Suspect) -> Readings:
        readings: Readings = {
            "none": partial(suspect.read_model, route="model"),
            "none, renders at the pose key": partial(suspect.read_model, route="render"),
            **suspect.attacked_models(DISC_MODEL_CASES, "model"),
            "one picture": suspect.read_picture,
            "one picture, drawn as thin Gaussians": suspect.read_thin,
            **suspect.attacked_pictures(DISC_PICTURE_CASES),
        }
        if suspect.opened.landmarks is not None:
            readings["one picture, camera not known"] = partial(suspect.read_picture, known=False)
        return readings

    return _row("2DGS (made from 3DGS)", original, discs, config, mark, read, seed, views, size)


def measure_codebook(
    original: GaussianModel, compressed: CodebookModel, key: OwnerKey, config: EmbedConfig, folder: Path, seed: int = 0
) -> VariantRow:
    """Mark a codebook model made from the original and fill its row, see `measure_discs`.

    Its files go into the folder, below "before" and "after".
    """
    write_codebook(compressed, folder / "before")
    compressed = read_codebook(folder / "before")

    def mark(finer: EmbedConfig) -> tuple[GaussianModel, OpenedRecord]:
        digest = hashlib.sha256((folder / "before" / PLY).read_bytes()).hexdigest()
        marked, embedding = embed_codebook(compressed, key, MarkTerms(bits=BITS, config=finer), original_sha256=digest)
        write_codebook(marked, folder / "after")
        return read_codebook(folder / "after").decode(), open_record(embedding.record.to_bytes(key), key, MADE_FIRST)

    return _row("Compact3D (made)", original, compressed.decode(), config, mark, _read_everything, seed)


def measure_generated(
    original: GaussianModel, generated: GaussianModel, key: OwnerKey, config: EmbedConfig, folder: Path, seed: int = 0
) -> VariantRow:
    """Mark a model generated after the original through the hook, on its raw file, and fill its row.

    See `measure_discs`. The file goes into the folder and, below "records", the record: there must be none in it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "generated.ply"
    write_whole(path, write_raw_ply(generated, seed=seed))

    def mark(finer: EmbedConfig) -> tuple[GaussianModel, OpenedRecord]:
        mark_generated(path, key, folder / "records", bits=BITS, config=finer)
        (record,) = (folder / "records").glob("*.record")
        return read_model(path).model, open_record(record.read_bytes(), key, MADE_FIRST)

    return _row("DreamGaussian (made)", original, read_model(path).model, config, mark, _read_everything, seed)


def measure_spacetime(
    truth: _Truth, original: SpacetimeModel, key: OwnerKey, config: EmbedConfig, *, seed: int = 0
) -> VariantRow:
    """Mark Spacetime Gaussians, fitted to the truth, and fill their row; see `measure_discs`.

    Evidence from the 4-D file; from exports and pictures at every time; from attacked ones; and with the moment of an
    export and of a picture not known.
    """
    original, _ = read_spacetime_ply(b"".join(write_spacetime_ply(original)), file="original")
    cameras = _views(original.canonical(), len(TIMES), SIZE, seed)

    def pictures(scene: _Truth) -> list[Float32]:
        return [_shot(scene.at(time), camera) for time, camera in zip(TIMES, cameras, strict=True)]

    real, before = pictures(truth), pictures(original)
    config = replace(config, psnr_db=fidelity_for(real, before, config.psnr_db))
    marked, embedding = embed_moving(original, key, MarkTerms(bits=BITS, config=config))
    marked, _ = read_spacetime_ply(b"".join(write_spacetime_ply(marked)), file="marked")
    after = pictures(marked)
    opened = open_record(embedding.record.to_bytes(key), key, MADE_FIRST)
    shown = [
        Suspect(visible(marked.at(time)), [after[k]], [cameras[k]], move_record(opened, original, time), seed)
        for k, time in enumerate(TIMES)
    ]
    readings: Readings = {"none, 4-D file": lambda: verify_model(marked.canonical(), opened)}
    for time, suspect in zip(TIMES, shown, strict=True):
        readings[f"export at t = {time:g}"] = suspect.read_model
        readings[f"picture at t = {time:g}"] = suspect.read_picture
    middle = len(TIMES) // 2
    attacked = shown[middle].attacked_models(MODEL_CASES) | shown[middle].attacked_pictures(PICTURE_CASES)
    readings |= {f"t = {TIMES[middle]:g}, {case}": read for case, read in attacked.items()}
    moments = np.linspace(*original.span, SEARCHED_MOMENTS).tolist()
    readings["export, moment not known"] = lambda: verify_moment(shown[1].marked, opened, original)
    readings[f"picture, one of {SEARCHED_MOMENTS} moments"] = lambda: verify_moving_images(
        [after[middle]], opened, original, moments, cameras=[cameras[middle]]
    )[0]
    return measure_variant("4DGS (Spacetime, made)", real, before, after, readings)


def _read_everything(suspect: Suspect) -> Readings:
    pictures = {f"picture {k + 1}": partial(suspect.read_picture, view=k) for k in range(len(suspect.cameras))}
    return {
        "none": suspect.read_model,
        "none, renders at the pose key": partial(suspect.read_model, route="render"),
        **pictures,
        **suspect.attacked_models(MODEL_CASES),
        **suspect.attacked_pictures(PICTURE_CASES),
    }


def _row(
    name: str,
    original: GaussianModel,
    unmarked: GaussianModel,
    config: EmbedConfig,
    mark: Callable[[EmbedConfig], tuple[GaussianModel, OpenedRecord]],
    read: Callable[[Suspect], Readings],
    seed: int,
    views: int = VIEWS,
    size: int = SIZE,
) -> VariantRow:
    """The row of a variant that stands still."""
    cameras = _views(original, views, size, seed)
    truth, before = ([_shot(model, camera) for camera in cameras] for model in (original, unmarked))
    marked, opened = mark(replace(config, psnr_db=fidelity_for(truth, before, config.psnr_db)))
    after = [_shot(marked, camera) for camera in cameras]
    return measure_variant(name, truth, before, after, read(Suspect(marked, after, cameras, opened, seed)))


def _views(model: GaussianModel, count: int, size: int, seed: int) -> list[Camera]:
    """Views that neither the mark nor a fit has seen."""
    return make_rig(model, count, size, size, jitter=np.random.default_rng(seed).random((count, 4)))


def _shot(model: GaussianModel, camera: Camera) -> Float32:
    return np.clip(render(model, camera), 0.0, 1.0)
