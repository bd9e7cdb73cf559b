"""The objects at the start of a scenario: read, trained, scanned or generated; made of a kind, marked, and placed."""

import hashlib
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from engine.errors import InputError
from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import profile
from engine.flows.embed.terms import MarkTerms
from engine.flows.progress import Progress
from engine.flows.records.opened_record import OpenedRecord, open_record
from engine.flows.views.camera_rig import make_rig
from engine.lab.points.trajectory import Trajectory, read_trajectory
from engine.lab.sim.capture.photos import train_from_colmap
from engine.lab.sim.capture.pose_estimation import odometry, reconstruct
from engine.lab.sim.capture.scans import points_to_model, read_scans, scans_to_model
from engine.lab.sim.capture.trainer import TrainConfig
from engine.lab.sim.edits.edit import EditTrack, place
from engine.lab.sim.scenario.state import Clip, Tracked, World
from engine.lab.sim.scenario.tables import Table, given
from engine.lab.sim.variants.codebooks import make_codebook
from engine.lab.sim.variants.generative import FEW_GAUSSIANS, generate_from_views, mark_generated
from engine.lab.sim.variants.hybrid import HybridPart
from engine.lab.sim.variants.synthetic import fit_spacetime, make_discs, set_in_motion
from engine.model import ATTRIBUTES, GaussianModel
from engine.numerics.similarity import transform_model
from engine.numerics.umeyama import Similarity
from engine.raster import render
from engine.scenes.clip_marking import Moving, move_record
from engine.scenes.codebook_model import CodebookModel
from engine.scenes.scene_files import CODEBOOK, SPACETIME, Loaded, Scene, read_scene
from engine.scenes.scene_marking import embed_scene
from engine.watermark.keys import OwnerKey
from engine.watermark.rates import MADE_FIRST


def read_optional(table: Table, name: str) -> Path | None:
    """An existing file, or None where not given."""
    return table.file(name) if name in table else None


@dataclass(frozen=True)
class Photos:
    """Photos of a place; where they were taken is known, or found by structure from motion (extra `capture`)."""

    photos: Path = given(Table.file)  # their folder
    colmap: Path | None = given(read_optional)  # folder of their COLMAP reconstruction
    size: int = given(Table.integer, 400, 64, 4096)  # longest side of the photos in training, pixels
    steps: int = given(Table.integer, 2000, 1, 1_000_000)
    hold_out: int = given(Table.integer, 8, 0, 1000)  # one photo of so many is kept for measuring


@dataclass(frozen=True)
class Scans:
    """A point cloud; or LiDAR scans, whose path is known, or found by odometry (extra `capture`)."""

    points: Path = given(Table.file)  # a file, or the folder of the scans
    path: Path | None = given(read_optional)  # TUM or KITTI
    odometry: bool = given(Table.flag, False)


Source = Path | Photos | Scans


def read_source(table: Table, name: str) -> Source:
    """The file of a model, or what to make one from."""
    if "photos" in table:
        return table.read(Photos)
    return table.read(Scans) if "points" in table else table.file("model")


def read_name(table: Table, name: str) -> str:
    """The object's own, or that of its file."""
    if "photos" in table or "points" in table:
        return table.text(name, "capture")
    return table.text(name, table.file("model").name.split(".")[0])


@dataclass(frozen=True, eq=False)
class Unmarked:
    """An object before it is marked."""

    loaded: Loaded
    note: str  # how it came to be; empty for a file


def load_source(source: Source, name: str, kind: str, seed: int, progress: Progress) -> Unmarked:
    """Read, train or build what an object starts from, and make it one of the KINDS."""
    if isinstance(source, Path):
        unmarked = Unmarked(read_scene(source), "")
    elif isinstance(source, Photos):
        unmarked = _from_photos(source, name, seed, progress)
    else:
        unmarked = _from_scans(source, name, progress)
    return KINDS[kind](unmarked, seed, progress)


def _from_photos(source: Photos, name: str, seed: int, progress: Progress) -> Unmarked:
    with tempfile.TemporaryDirectory() as work:
        colmap, found = source.colmap, ""
        if colmap is None:
            placed = reconstruct(source.photos, work, seed=seed, threads=1, progress=progress)
            colmap = placed.folder
            found = f"placed {placed.photos_placed} of {placed.photos} photos, "
            found += f"reprojection error {placed.reprojection_error:.2f} px; "
        made = train_from_colmap(
            colmap,
            source.photos,
            size=source.size,
            hold_out=source.hold_out,
            config=TrainConfig(steps=source.steps, seed=seed),
            progress=progress,
        )
    held_out = "" if made.psnr_held_out is None else f", psnr_held_out {made.psnr_held_out:.2f}"
    return Unmarked(
        _loaded(made.model, "photos"),
        f"{name}: {found}{len(made.model)} Gaussians trained on {len(made.psnr)} photos in {source.steps} steps,"
        f" {made.steps_per_second:.1f} a second; psnr_trained {made.psnr_trained:.2f}{held_out}",
    )


def _from_scans(source: Scans, name: str, progress: Progress) -> Unmarked:
    if source.path is None and not source.odometry:
        made = points_to_model(source.points, progress=progress)
    else:
        scans = read_scans(source.points)
        path: Trajectory = read_trajectory(source.path) if source.path is not None else odometry(scans)
        made = scans_to_model(scans, path, progress=progress)
    note = f"{len(made.model)} Gaussians of {made.points_read} points, colors from {made.colors_from}"
    return Unmarked(_loaded(made.model, "points"), f"{name}: {note}")


def _loaded(scene: Scene, format_name: str) -> Loaded:
    """A scene that came from no file; its digest is that of its arrays."""
    shell = Loaded(scene, format_name, (), 0, "")
    model = shell.model
    digest = hashlib.sha256(b"".join(getattr(model, name).tobytes() for name in ATTRIBUTES)).hexdigest()
    return Loaded(scene, format_name, (), 0, digest)


def _plain(unmarked: Unmarked) -> GaussianModel:
    if not isinstance(unmarked.loaded.scene, GaussianModel):
        raise InputError(f"a {unmarked.loaded.format} scene is of a kind of its own; leave `kind` out")
    return unmarked.loaded.scene


def _as_it_is(unmarked: Unmarked, seed: int, progress: Progress) -> Unmarked:
    return unmarked


def _as_discs(unmarked: Unmarked, seed: int, progress: Progress) -> Unmarked:
    discs = make_discs(_plain(unmarked), advance=lambda part: progress("discs", part))
    return Unmarked(_loaded(discs, "discs"), "discs made of it, not trained (2DGS)")


def _as_codebook(unmarked: Unmarked, seed: int, progress: Progress) -> Unmarked:
    book = make_codebook(_plain(unmarked), seed=seed)
    sizes = ", ".join(f"{name} {len(codes)}" for name, codes in book.centers.items())
    return Unmarked(_loaded(book, CODEBOOK), f"quantized to codebooks (Compact3D): {sizes}")


def _as_clip(unmarked: Unmarked, seed: int, progress: Progress) -> Unmarked:
    clip = fit_spacetime(set_in_motion(_plain(unmarked), seed=seed))
    return Unmarked(_loaded(clip, SPACETIME), "set in motion, not captured (4DGS)")


GENERATED_VIEWS, GENERATED_SIZE, GENERATED_POINTS, GENERATED_STEPS = 24, 256, 4000, 400
"""Renders, on black, that guide a generated object in the place of a diffusion model; and how long it is optimized."""


def _as_generated(unmarked: Unmarked, seed: int, progress: Progress) -> Unmarked:
    model = _plain(unmarked)
    cameras = make_rig(model, GENERATED_VIEWS, GENERATED_SIZE, GENERATED_SIZE)
    images: Any = [np.clip(render(model, camera), 0.0, 1.0) for camera in cameras]
    grown = generate_from_views(
        cameras,
        images,
        points=GENERATED_POINTS,
        steps=GENERATED_STEPS,
        seed=seed,
        advance=lambda part: progress("generate", part),
    )
    return Unmarked(
        _loaded(grown, "generated"), f"{len(grown)} Gaussians grown from a random ball towards {len(cameras)} renders"
    )


KINDS: dict[str, Callable[[Unmarked, int, Progress], Unmarked]] = {
    "as it is": _as_it_is,
    "discs": _as_discs,
    "codebook": _as_codebook,
    "clip": _as_clip,
    "generated": _as_generated,
}
"""What an object may be made into before it is marked, as what it then is."""


@dataclass(frozen=True)
class Part:
    """One object at the start."""

    source: Source = given(read_source)  # a model file, or what to make one from
    name: str = given(read_name)
    bits: int = given(Table.integer, 32, 0, 256)  # length of its message; 0 leaves it unmarked
    profile: str = given(Table.text, "balanced")  # of the embedding
    kind: str = given(Table.text, "as it is", tuple(KINDS))  # what is made of it before it is marked
    shift: tuple[float, ...] = given(Table.vector, (0.0, 0.0, 0.0))  # scene units
    turn: tuple[float, ...] = given(Table.vector, (0.0, 0.0, 0.0))  # rotation vector, degrees
    scale: float = given(Table.number, 1.0, 1e-6, 1e6)


def scenario_key(seed: int) -> OwnerKey:
    """The owner's key of a scenario: reproducible, so never for real use."""
    return OwnerKey(hashlib.sha256(f"mark3dgs scenario key {seed}".encode()).digest())


def load_world(parts: Sequence[Part], seed: int, progress: Progress) -> tuple[World, tuple[str, ...]]:
    """The world as delivered, and notes on how its objects were made."""
    world = World({}, {}, {}, {}, scenario_key(seed))
    notes: list[str] = []
    for part in parts:

        def part_progress(stage: str, fraction: float, part: Part = part) -> None:
            progress(f"{part.name}: {stage}", fraction)

        unmarked = load_source(part.source, part.name, part.kind, seed, part_progress)
        notes += [unmarked.note] if unmarked.note else []
        made = _mark_part(unmarked, part, world.key, part_progress)
        world = _put(world, part, made)
    return world, tuple(notes)


class _Made(NamedTuple):
    """An object, marked, in its own frame."""

    still: GaussianModel  # what the world holds of it
    unmarked: GaussianModel
    opened: OpenedRecord | None
    moving: tuple[Moving, Moving] | None = None  # marked and original, where it moves


def _mark_part(unmarked: Unmarked, part: Part, key: OwnerKey, progress: Progress) -> _Made:
    """Marked as what it is: plain Gaussians and discs, codebooks, clips, and what a generator makes."""
    loaded, config = unmarked.loaded, profile(part.profile)
    scene = loaded.scene
    if isinstance(scene, GaussianModel):
        if not part.bits:
            return _Made(scene, scene, None)
        if loaded.format == "generated":
            return _mark_at_birth(scene, key, part)
        marked, opened = mark(scene, key, loaded.sha256, part.bits, part.profile, copy=part.name, progress=progress)
        return _Made(marked, scene, opened)
    new, opened_new = scene, None
    if part.bits:
        marks = embed_scene(loaded, key, (part.name,), MarkTerms(config=config, bits=part.bits), progress)
        ((made, embedding),) = marks
        assert not isinstance(made, GaussianModel)  # the same kind comes back
        new, opened_new = made, open_record(embedding.record.to_bytes(key), key, MADE_FIRST)
    if isinstance(scene, CodebookModel) or isinstance(new, CodebookModel):
        return _Made(HybridPart(new, Similarity.identity()).still(), loaded.model, opened_new)
    still = HybridPart(new, Similarity.identity(), _middle(scene)).still()
    return _Made(still, loaded.model, opened_new, (new, scene))


def _mark_at_birth(grown: GaussianModel, key: OwnerKey, part: Part) -> _Made:
    """Through the generator's hook: nothing leaves it without a mark, and the record is there before."""
    with tempfile.TemporaryDirectory() as folder:
        marked = mark_generated(grown, key, folder, bits=part.bits, config=FEW_GAUSSIANS)
        (record,) = Path(folder).glob("*.record")
        return _Made(marked, grown, open_record(record.read_bytes(), key, MADE_FIRST))


def _middle(clip: Moving) -> float:
    return 0.5 * (clip.span[0] + clip.span[1])


def _put(world: World, part: Part, made: _Made) -> World:
    """The world with one more object in its place."""
    turn = Rotation.from_rotvec(np.radians(part.turn)).as_matrix()
    there = Similarity(part.scale, turn, np.asarray(part.shift))
    still, track = made.still, EditTrack()
    if part.scale != 1.0 or any(part.shift) or any(part.turn):
        still, edit = place(still, np.ones(len(still), dtype=np.bool_), there)  # the first thing done to it
        track = track.then(edit)
    records, clips, tracks = dict(world.records), dict(world.clips), dict(world.tracks)
    if made.moving is None:
        tracks[part.name] = Tracked(track, still)
    if made.opened is not None:
        records[part.name] = made.opened
    if made.opened is not None and made.moving is not None:
        marked, original = made.moving
        put = partial(transform_model, scale=part.scale, R=turn, t=np.asarray(part.shift))
        clips[part.name] = Clip(marked, original, made.opened, put, _middle(original), still)
        records[part.name] = move_record(made.opened, original, _middle(original))
    return replace(
        world,
        objects={**world.objects, part.name: still},
        unmarked={**world.unmarked, part.name: made.unmarked},
        profiles={**world.profiles, part.name: part.profile},
        records=records,
        clips=clips,
        tracks=tracks,
    )


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
