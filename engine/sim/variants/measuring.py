"""Rows of Table 4 for scenes that move, codebook files and generated models.

Each variant goes through its own files before the mark and after it. Extraction is informed: it uses the owner's
record, which the systems in the paper's table do without.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from engine.formats import read_model
from engine.formats.writing import write_whole
from engine.model import Camera, Float32, GaussianModel
from engine.pipeline.profiles import EmbedConfig
from engine.pipeline.rigs import make_rig
from engine.pipeline.sealing import OpenedRecord, open_record
from engine.pipeline.verification import Verification, VerifyConfig, verify_images, verify_model
from engine.raster import render
from engine.sim.attacks import image_attack, model_attack
from engine.sim.variants.codebook import CodebookModel, embed_codebook
from engine.sim.variants.codebook_files import read_codebook, write_codebook
from engine.sim.variants.generative import marking, write_raw_ply
from engine.sim.variants.moments import verify_moment, verify_moving_images
from engine.sim.variants.moving import embed_moving, move_record, visible
from engine.sim.variants.spacetime import SpacetimeModel
from engine.sim.variants.spacetime_ply import read_spacetime_ply, write_spacetime_ply
from engine.sim.variants.table4 import VariantRow, fidelity_for, measure_variant
from engine.watermark.keys import OwnerKey

__all__ = ["MODEL_CASES", "PICTURE_CASES", "measure_codebook", "measure_generated", "measure_spacetime"]

MODEL_CASES: tuple[tuple[str, float | str], ...] = (
    ("clone", 0.5),
    ("prune_random", 0.2),
    ("crop", 0.1),
    ("noise_all", 0.1),
    ("similarity", 2.0),
    ("quantize", 8),
    ("convert", "splat"),
    ("convert", "sog"),
)
"""Attacks on the marked variant as plain Gaussians, and their strengths."""

PICTURE_CASES: tuple[tuple[str, float], ...] = (
    ("jpeg", 10.0),
    ("noise_image", 0.1),
    ("rotate_image", 30.0),
    ("crop_image", 0.4),
    ("scale_image", 0.75),
)
"""Attacks on one picture of the marked variant, its camera known, and their strengths."""

SEARCHED_MOMENTS = 5
"""Moments that are tried where nobody knows when a picture was taken."""


class _Truth(Protocol):
    def at(self, time: float) -> GaussianModel: ...


def measure_spacetime(
    truth: _Truth,
    original: SpacetimeModel,
    key: OwnerKey,
    config: EmbedConfig,
    *,
    bits: int = 32,
    times: Sequence[float] = (0.0, 0.25, 0.5, 0.75, 1.0),
    size: int = 512,
    seed: int = 0,
) -> VariantRow:
    """Mark Spacetime Gaussians and fill their row, each view at another time.

    Parameters
    ----------
    truth : object with ``at(time) -> GaussianModel``
        What the original was fitted to.
    config : EmbedConfig
        Its fidelity is raised as far as `fidelity_for` asks.
    times : sequence of float
        One view each; the middle one is attacked.
    size, seed : int
        Side of the pictures; seed of views and attacks.

    Returns
    -------
    VariantRow
        Evidence from the 4-D file; from exports and pictures at every time; from attacked ones; and with the moment
        of an export and of a picture not known.
    """
    original, _ = read_spacetime_ply(b"".join(write_spacetime_ply(original)), file="original")
    cameras = _views(original.canonical(), len(times), size, seed)

    def pictures(scene: _Truth) -> list[Float32]:
        return [_shot(scene.at(time), camera) for time, camera in zip(times, cameras, strict=True)]

    real, before = pictures(truth), pictures(original)
    config = replace(config, psnr_db=fidelity_for(real, before, config.psnr_db))
    marked, embedding = embed_moving(original, key, bits=bits, config=config)
    marked, _ = read_spacetime_ply(b"".join(write_spacetime_ply(marked)), file="marked")
    after = pictures(marked)
    opened = open_record(embedding.record.to_bytes(key), key)
    at = {time: move_record(opened, original, time) for time in times}

    def export(time: float) -> GaussianModel:
        return visible(marked.at(time))

    readings: dict[str, Callable[[], Verification]] = {
        "none, 4-D file": lambda: verify_model(marked.canonical(), opened)
    }
    for k, time in enumerate(times):
        readings[f"export at t = {time:g}"] = lambda t=time: verify_model(export(t), at[t])  # type: ignore[misc]
        readings[f"picture at t = {time:g}"] = lambda t=time, k=k: verify_images(  # type: ignore[misc]
            [after[k]], at[t], None, [cameras[k]]
        )
    middle = len(times) // 2
    time = times[middle]
    readings |= _attacked(export(time), after[middle], cameras[middle], at[time], f"t = {time:g}, ", seed)

    low, high = original.span
    moments = np.linspace(low, high, SEARCHED_MOMENTS).tolist()
    readings["export, moment not known"] = lambda: verify_moment(export(times[1]), opened, original)
    readings[f"picture, one of {SEARCHED_MOMENTS} moments"] = lambda: verify_moving_images(
        [after[middle]], opened, original, moments, cameras=[cameras[middle]]
    )[0]
    return measure_variant("4DGS (Spacetime, made)", real, before, after, readings)


def measure_codebook(
    original: GaussianModel,
    compressed: CodebookModel,
    key: OwnerKey,
    config: EmbedConfig,
    folder: Path,
    *,
    bits: int = 32,
    views: int = 6,
    size: int = 512,
    seed: int = 0,
) -> VariantRow:
    """Mark a codebook model and fill its row.

    Parameters
    ----------
    original : GaussianModel
        What was compressed: the truth.
    config : EmbedConfig
        Its fidelity is raised as far as `fidelity_for` asks.
    folder : Path
        For its files, below "before" and "after".
    bits, views, size, seed : int
        Length of the message; pictures, their side in pixels; seed of views and attacks.
    """
    write_codebook(compressed, folder / "before")
    compressed = read_codebook(folder / "before")
    plain = compressed.decode()
    cameras = _views(original, views, size, seed)
    truth, before = ([_shot(model, camera) for camera in cameras] for model in (original, plain))
    config = replace(config, psnr_db=fidelity_for(truth, before, config.psnr_db))
    digest = hashlib.sha256((folder / "before" / "point_cloud.ply").read_bytes()).hexdigest()
    marked, embedding = embed_codebook(compressed, key, original_sha256=digest, bits=bits, config=config)
    write_codebook(marked, folder / "after")
    suspect = read_codebook(folder / "after").decode()
    opened = open_record(embedding.record.to_bytes(key), key)
    return _row("Compact3D (made)", truth, before, suspect, cameras, opened, seed)


def measure_generated(
    original: GaussianModel,
    generated: GaussianModel,
    key: OwnerKey,
    config: EmbedConfig,
    folder: Path,
    *,
    bits: int = 32,
    views: int = 6,
    size: int = 512,
    seed: int = 0,
) -> VariantRow:
    """Mark a generated model through the hook, on its raw file, and fill its row.

    Parameters
    ----------
    original : GaussianModel
        The object it was made after: the truth.
    config : EmbedConfig
        Its fidelity is raised as far as `fidelity_for` asks.
    folder : Path
        For the raw file and, below "records", the record; there must be no record in it.
    bits, views, size, seed : int
        Length of the message; pictures, their side in pixels; seed of views and attacks.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "generated.ply"
    write_whole(path, write_raw_ply(generated, seed=seed))
    raw = read_model(path).model
    cameras = _views(original, views, size, seed)
    truth, before = ([_shot(model, camera) for camera in cameras] for model in (original, raw))
    config = replace(config, psnr_db=fidelity_for(truth, before, config.psnr_db))
    marking(key, folder / "records", bits=bits, config=config)(path)
    (record,) = (folder / "records").glob("*.record")
    opened = open_record(record.read_bytes(), key)
    return _row("DreamGaussian (made)", truth, before, read_model(path).model, cameras, opened, seed)


def _row(
    name: str,
    truth: Sequence[Float32],
    before: Sequence[Float32],
    marked: GaussianModel,
    cameras: Sequence[Camera],
    opened: OpenedRecord,
    seed: int,
) -> VariantRow:
    after = [_shot(marked, camera) for camera in cameras]
    readings: dict[str, Callable[[], Verification]] = {"none": lambda: verify_model(marked, opened)}
    readings["none, renders at the pose key"] = lambda: verify_model(marked, opened, VerifyConfig(route="render"))
    for k, camera in enumerate(cameras):
        readings[f"picture {k + 1}"] = lambda k=k, camera=camera: verify_images(  # type: ignore[misc]
            [after[k]], opened, None, [camera]
        )
    readings |= _attacked(marked, after[0], cameras[0], opened, "", seed)
    return measure_variant(name, truth, before, after, readings)


def _attacked(
    marked: GaussianModel, picture: Float32, camera: Camera, opened: OpenedRecord, prefix: str, seed: int
) -> dict[str, Callable[[], Verification]]:
    def of_model(name: str, strength: float | str) -> Callable[[], Verification]:
        return lambda: verify_model(model_attack(name).apply(marked, strength, rng=seed), opened)

    def of_picture(name: str, strength: float) -> Callable[[], Verification]:
        return lambda: verify_images([image_attack(name).apply(picture, strength, rng=seed)], opened, None, [camera])

    cases = {f"{prefix}{name} {strength}": of_model(name, strength) for name, strength in MODEL_CASES}
    return cases | {f"{prefix}picture, {name} {s:g}": of_picture(name, s) for name, s in PICTURE_CASES}


def _views(model: GaussianModel, count: int, size: int, seed: int) -> list[Camera]:
    """Views that neither the mark nor a fit has seen."""
    return make_rig(model, count, size, size, jitter=np.random.default_rng(seed).random((count, 4)))


def _shot(model: GaussianModel, camera: Camera) -> Float32:
    return np.clip(render(model, camera), 0.0, 1.0)
