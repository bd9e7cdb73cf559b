"""Where the objects of a scenario come from: files of any kind, photos, point clouds, scans; and what they become."""

import hashlib
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from engine.errors import InputError
from engine.flows.views.camera_rig import make_rig
from engine.lab.points.trajectory import Trajectory, read_trajectory
from engine.lab.sim.capture.from_colmap import train_from_colmap
from engine.lab.sim.capture.from_points import points_to_model, read_scans, scans_to_model
from engine.lab.sim.capture.posing import odometry, reconstruct
from engine.lab.sim.capture.training import TrainConfig
from engine.lab.sim.scenario.tables import Table, given
from engine.lab.sim.variants.discs import make_discs
from engine.lab.sim.variants.generative import generate_from_views
from engine.lab.sim.variants.swaying import fit_spacetime, set_in_motion
from engine.model import ATTRIBUTES, GaussianModel
from engine.raster import render
from engine.scenes.codebook_marking import make_codebook
from engine.scenes.scene_files import CODEBOOK, SPACETIME, Loaded, Scene, read_scene

__all__ = ["KINDS", "Brought", "Photos", "Scans", "Source", "bring", "read_name", "read_source"]

Told = Callable[[str, float], None]


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
class Brought:
    """An object before it is marked."""

    loaded: Loaded
    note: str  # how it came to be; empty for a file


def bring(source: Source, name: str, kind: str, seed: int, told: Told) -> Brought:
    """Read, train or build what an object starts from, and make it one of the KINDS."""
    if isinstance(source, Path):
        brought = Brought(read_scene(source), "")
    elif isinstance(source, Photos):
        brought = _from_photos(source, name, seed, told)
    else:
        brought = _from_scans(source, name, told)
    return KINDS[kind](brought, seed, told)


def _from_photos(source: Photos, name: str, seed: int, told: Told) -> Brought:
    with tempfile.TemporaryDirectory() as work:
        colmap, found = source.colmap, ""
        if colmap is None:
            structure = reconstruct(source.photos, work, seed=seed, threads=1, progress=told)
            colmap = structure.folder
            found = (
                "placed {photos_placed} of {photos} photos, reprojection error {reprojection_error:.2f} px; ".format(
                    **structure.report
                )
            )
        made = train_from_colmap(
            colmap,
            source.photos,
            size=source.size,
            hold_out=source.hold_out,
            config=TrainConfig(steps=source.steps, seed=seed),
            progress=told,
        )
    report = made.report
    quality = ", ".join(f"{k} {v:.2f}" for k, v in report.items() if k.startswith("psnr") and isinstance(v, float))
    return Brought(
        _loaded(made.model, "photos"),
        f"{name}: {found}{report['gaussians']} Gaussians trained on {report['photos']} photos in"
        f" {report['steps']} steps, {report['steps_per_second']:.1f} a second; {quality}",
    )


def _from_scans(source: Scans, name: str, told: Told) -> Brought:
    if source.path is None and not source.odometry:
        made = points_to_model(source.points, progress=told)
    else:
        scans, _ = read_scans(source.points)
        path: Trajectory = read_trajectory(source.path) if source.path is not None else odometry(scans)
        made = scans_to_model(scans, path, progress=told)
    report = made.report
    return Brought(
        _loaded(made.model, "points"),
        f"{name}: {report['gaussians']} Gaussians of {report['points']} points, colours from {report['colors_from']}",
    )


def _loaded(scene: Scene, format_name: str) -> Loaded:
    """A scene that came from no file; its digest is that of its arrays."""
    shell = Loaded(scene, format_name, (), 0, "")
    model = shell.model
    digest = hashlib.sha256(b"".join(getattr(model, name).tobytes() for name in ATTRIBUTES)).hexdigest()
    return Loaded(scene, format_name, (), 0, digest)


def _plain(brought: Brought) -> GaussianModel:
    if not isinstance(brought.loaded.scene, GaussianModel):
        raise InputError(f"a {brought.loaded.format} scene is of a kind of its own; leave `kind` out")
    return brought.loaded.scene


def _as_it_is(brought: Brought, seed: int, told: Told) -> Brought:
    return brought


def _as_discs(brought: Brought, seed: int, told: Told) -> Brought:
    discs = make_discs(_plain(brought), advance=lambda part: told("discs", part))
    return Brought(_loaded(discs, "discs"), "discs made of it, not trained (2DGS)")


def _as_codebook(brought: Brought, seed: int, told: Told) -> Brought:
    book = make_codebook(_plain(brought), seed=seed)
    sizes = ", ".join(f"{name} {len(codes)}" for name, codes in book.centers.items())
    return Brought(_loaded(book, CODEBOOK), f"quantised to codebooks (Compact3D): {sizes}")


def _as_clip(brought: Brought, seed: int, told: Told) -> Brought:
    clip = fit_spacetime(set_in_motion(_plain(brought), seed=seed))
    return Brought(_loaded(clip, SPACETIME), "set in motion, not captured (4DGS)")


GENERATED_VIEWS, GENERATED_SIZE, GENERATED_POINTS, GENERATED_STEPS = 24, 256, 4000, 400
"""Renders, on black, that guide a generated object in the place of a diffusion model; and how long it is optimised."""


def _as_generated(brought: Brought, seed: int, told: Told) -> Brought:
    model = _plain(brought)
    cameras = make_rig(model, GENERATED_VIEWS, GENERATED_SIZE, GENERATED_SIZE)
    images: Any = [np.clip(render(model, camera), 0.0, 1.0) for camera in cameras]
    grown = generate_from_views(
        cameras,
        images,
        points=GENERATED_POINTS,
        steps=GENERATED_STEPS,
        seed=seed,
        advance=lambda part: told("generate", part),
    )
    return Brought(
        _loaded(grown, "generated"), f"{len(grown)} Gaussians grown from a random ball towards {len(cameras)} renders"
    )


KINDS: dict[str, Callable[[Brought, int, Told], Brought]] = {
    "as it is": _as_it_is,
    "discs": _as_discs,
    "codebook": _as_codebook,
    "clip": _as_clip,
    "generated": _as_generated,
}
"""What an object may be made into before it is marked, as what it then is."""
