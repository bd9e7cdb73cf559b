"""The start of a scenario: objects as they are written, read or trained, marked and placed."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from engine.formats import read_model
from engine.model import GaussianModel
from engine.numerics.similarity import transform_model
from engine.pipeline.embedding import embed
from engine.pipeline.profiles import profile
from engine.pipeline.progress import Progress
from engine.pipeline.sealing import OpenedRecord, open_record
from engine.sim.capture.from_colmap import train_from_colmap
from engine.sim.capture.training import TrainConfig
from engine.sim.scenario.tables import Table, given
from engine.sim.scenario.world import World
from engine.watermark.keys import OwnerKey
from engine.watermark.rates import MADE_FIRST

__all__ = ["Part", "Photos", "load_world", "mark", "scenario_key"]


@dataclass(frozen=True)
class Photos:
    """Photos with a COLMAP reconstruction, from which an object is trained."""

    colmap: Path = given(Table.file)  # folder of the reconstruction
    photos: Path = given(Table.file)  # their folder
    size: int = given(Table.integer, 400, 64, 4096)  # longest side of the photos in training, pixels
    steps: int = given(Table.integer, 2000, 1, 1_000_000)
    hold_out: int = given(Table.integer, 8, 0, 1000)  # one photo of so many is kept for measuring


def read_source(table: Table, name: str) -> Path | Photos:
    """The file of a model, or the photos to train one from."""
    return table.read(Photos) if "photos" in table else table.file("model")


def read_name(table: Table, name: str) -> str:
    """The object's own, or that of its file."""
    return table.text(name, "capture" if "photos" in table else table.file("model").name.split(".")[0])


@dataclass(frozen=True)
class Part:
    """One object at the start."""

    source: Path | Photos = given(read_source)  # a model file, or what to train one from
    name: str = given(read_name)
    bits: int = given(Table.integer, 32, 0, 256)  # length of its message; 0 leaves it unmarked
    profile: str = given(Table.text, "balanced")  # of the embedding
    shift: tuple[float, ...] = given(Table.vector, (0.0, 0.0, 0.0))  # scene units
    turn: tuple[float, ...] = given(Table.vector, (0.0, 0.0, 0.0))  # rotation vector, degrees
    scale: float = given(Table.number, 1.0, 1e-6, 1e6)


def scenario_key(seed: int) -> OwnerKey:
    """The owner's key of a scenario: reproducible, so never for real use."""
    return OwnerKey(hashlib.sha256(f"mark3dgs scenario key {seed}".encode()).digest())


def load_world(parts: Sequence[Part], seed: int, progress: Progress) -> tuple[World, tuple[str, ...]]:
    """The world as delivered, and what there is to say about how it came to be."""
    world = World({}, {}, {}, {}, scenario_key(seed))
    notes: list[str] = []
    for part in parts:
        model, digest = _bring(part, seed, progress, notes)
        delivered = model
        if part.bits:

            def told(stage: str, fraction: float, part: Part = part) -> None:
                progress(f"marking {part.name}: {stage}", fraction)

            delivered, opened = mark(model, world.key, digest, part.bits, part.profile, copy=part.name, progress=told)
            world = replace(world, records={**world.records, part.name: opened})
        world = replace(
            world,
            objects={**world.objects, part.name: _place(delivered, part)},
            unmarked={**world.unmarked, part.name: model},
            profiles={**world.profiles, part.name: part.profile},
        )
    return world, tuple(notes)


def mark(
    model: GaussianModel,
    key: OwnerKey,
    digest: str,
    bits: int,
    profile_name: str,
    *,
    copy: str,
    progress: Progress | None = None,
) -> tuple[GaussianModel, OpenedRecord]:
    """The marked model and its record, which has made the round trip through its bytes."""
    made = embed(
        model, key, original_sha256=digest, bits=bits, config=profile(profile_name), copy=copy, progress=progress
    )
    return made.model, open_record(made.record.to_bytes(key), key, MADE_FIRST)


def _bring(part: Part, seed: int, progress: Progress, notes: list[str]) -> tuple[GaussianModel, str]:
    """The object's model and the digest of what it was made of."""
    if not isinstance(part.source, Photos):
        loaded = read_model(part.source)
        return loaded.model, loaded.sha256
    photos = part.source

    def told(stage: str, fraction: float) -> None:
        progress(f"{part.name}: {stage}", fraction)

    capture = train_from_colmap(
        photos.colmap,
        photos.photos,
        size=photos.size,
        hold_out=photos.hold_out,
        config=TrainConfig(steps=photos.steps, seed=seed),
        progress=told,
    )
    report = capture.report
    notes.append(
        f"{part.name}: {report['gaussians']} Gaussians trained on {report['photos']} photos in"
        f" {report['steps']} steps, {report['steps_per_second']:.1f} a second; "
        + ", ".join(f"{k} {v:.2f}" for k, v in report.items() if k.startswith("psnr") and isinstance(v, float))
    )
    arrays = (capture.model.means, capture.model.log_scales, capture.model.quats, capture.model.opacity_logits)
    digest = hashlib.sha256(b"".join(a.tobytes() for a in (*arrays, capture.model.sh))).hexdigest()
    return capture.model, digest


def _place(model: GaussianModel, part: Part) -> GaussianModel:
    if part.scale == 1.0 and not any(part.shift) and not any(part.turn):
        return model
    turn = Rotation.from_rotvec(np.radians(part.turn)).as_matrix()
    return transform_model(model, part.scale, turn, np.asarray(part.shift))
