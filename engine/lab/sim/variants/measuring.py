"""Rows of Table 4 for made discs, scenes that move, codebook files and generated models.

Each variant goes through its own files before the mark and after it. Extraction is informed: it uses the owner's
record, which the systems in the paper's table do without.
"""

import hashlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np

from engine.errors import InputError
from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import EmbedConfig
from engine.flows.records.opened_record import OpenedRecord, open_record
from engine.flows.verify.verification import verify_model
from engine.flows.views.camera_rig import make_rig
from engine.formats import encode_model, read_model
from engine.formats.file_writing import write_whole
from engine.lab.sim.variants.generative import marking, write_raw_ply
from engine.lab.sim.variants.table4 import (
    DISC_MODEL_CASES,
    DISC_PICTURE_CASES,
    MODEL_CASES,
    PICTURE_CASES,
    Readings,
    Suspect,
    VariantRow,
    fidelity_for,
    measure_variant,
)
from engine.model import Camera, Float32, GaussianModel
from engine.raster import render
from engine.scenes.clip_marking import embed_moving, move_record, verify_moment, verify_moving_images, visible
from engine.scenes.codebook_files import PLY, read_codebook, write_codebook
from engine.scenes.codebook_marking import embed_codebook
from engine.scenes.codebook_model import CodebookModel
from engine.scenes.spacetime import SpacetimeModel
from engine.scenes.spacetime_ply import read_spacetime_ply, write_spacetime_ply
from engine.watermark.keys import OwnerKey
from engine.watermark.rates import MADE_FIRST

__all__ = ["measure_codebook", "measure_discs", "measure_generated", "measure_spacetime"]

BITS = 32
"""Of the message."""
VIEWS, SIZE = 6, 512
"""Views measured on, and their side in pixels."""
TIMES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Moments of a clip at which it is looked at, one view each; the middle one is attacked."""
SEARCHED_MOMENTS = 5
"""Moments that are tried where nobody knows when a picture was taken."""


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
        marked, embedding = embed_codebook(compressed, key, original_sha256=digest, bits=BITS, config=finer)
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
        marking(key, folder / "records", bits=BITS, config=finer)(path)
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
    marked, embedding = embed_moving(original, key, bits=BITS, config=config)
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
