"""Measures what is read in a mesh with colored corners that was made from a marked model, and in renders of it.

    python -m tests.flows.measure_meshes plant.splat guitar.compressed.ply

The mesh is made as nerfstudio's `ns-export poisson` makes it: points and normals from rendered depth of many views,
Poisson surface reconstruction (Kazhdan 2005, by Fourier transform), colors of the nearest points.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy.fft import irfftn, rfftn
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from engine.flows.verify.decision import VerifyConfig
from engine.flows.verify.search import verify_images, verify_model
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.marked_scene import configure, mark_scene
from engine.model import SH_C0, Camera, Float64, GaussianModel
from engine.raster.view import render, render_depth
from engine.scenes.scene_files import read_suspect
from engine.watermark.claim import Claim
from tests.flows.test_point_clouds import cloud_of

Corners = tuple[Float64, Float64]
"""Places (N, 3) and colors 0 to 1 (N, 3)."""


def seen_points(model: GaussianModel, cameras: list[Camera]) -> tuple[Float64, Float64, Float64]:
    """Points, colors and normals that turn to the camera, each (N, 3), of all pixels that show something solid."""
    found: list[tuple[Float64, Float64, Float64]] = []
    for camera in cameras:
        image, alpha, depth = (each.astype(np.float64) for each in render_depth(model, camera))
        y, x = np.mgrid[: camera.height, : camera.width] + 0.5
        rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(camera.K).T
        points = (rays * depth[..., None] - camera.viewmat[:3, 3]) @ camera.viewmat[:3, :3]
        across, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
        normals = np.cross(across, down)
        length = np.linalg.norm(normals, axis=-1, keepdims=True)
        normals /= np.maximum(length, 1e-30)
        normals *= np.sign(((camera.position - points) * normals).sum(axis=-1, keepdims=True))
        step = np.maximum(np.linalg.norm(across, axis=-1), np.linalg.norm(down, axis=-1))
        solid = (alpha > 0.9) & (step < 8 * depth / camera.K[0, 0])  # no edge of something in front
        found.append((points[solid], np.clip(image / np.maximum(alpha, 1e-9)[..., None], 0, 1)[solid], normals[solid]))
    points, colors, normals = (np.concatenate(each) for each in zip(*found, strict=True))
    return points, colors, normals


def poisson_mesh(points: Float64, normals: Float64, side: int) -> Float64:
    """Corners (N, 3) of the surface whose normals are those of the points, on a grid of side**3."""
    low, high = np.quantile(points, [0.002, 0.998], axis=0)
    cell = (high - low).max() * 1.2 / side
    start = (low + high) / 2 - cell * side / 2
    at = (points - start) / cell
    inside = ((at > 1) & (at < side - 2)).all(axis=1)
    at, normals = at[inside], normals[inside]
    field = np.zeros((3, side, side, side), np.float32)
    base = at.astype(np.int64)
    for corner in np.ndindex(2, 2, 2):
        weight = np.abs(1 - np.array(corner) - (at - base)).prod(axis=1)
        flat = np.ravel_multi_index(tuple((base + corner).T), (side,) * 3)
        for axis in range(3):
            field[axis] += np.bincount(flat, weight * normals[:, axis], side**3).reshape((side,) * 3)
    length = np.linalg.norm(field, axis=0)
    field /= np.maximum(length, 0.25 * np.median(length[length > 0]))  # every piece of surface counts once
    k = [2 * np.pi * np.fft.fftfreq(side), 2 * np.pi * np.fft.fftfreq(side), 2 * np.pi * np.fft.rfftfreq(side)]
    waves = np.meshgrid(*k, indexing="ij")
    square = sum(w**2 for w in waves)
    total = sum(1j * w * rfftn(each) for w, each in zip(waves, field, strict=True))
    solution = irfftn(-total * np.exp(-square / 2) / np.maximum(square, 1e-9), (side,) * 3)  # smoothed by a cell
    level = np.median(map_coordinates(solution, at.T, order=1))
    corners = marching_cubes(solution.astype(np.float32), float(level))[0]
    return np.asarray(corners * cell + start, dtype=np.float64)


def colored(corners: Float64, points: Float64, colors: Float64, reach: float) -> Corners:
    """Corners near points, each with the mean color of its four nearest."""
    distance, nearest = cKDTree(points).query(corners, k=4)
    near = distance[:, 0] < reach
    return corners[near], colors[nearest[near]].mean(axis=1)


def as_model(corners: Corners) -> GaussianModel:
    """For `cloud_of`, which looks at places and first coefficients alone."""
    places, colors = corners
    n = len(places)
    dc = ((colors - 0.5) / SH_C0)[:, None]
    return GaussianModel(places, np.zeros((n, 3)), np.tile([1.0, 0, 0, 0], (n, 1)), np.zeros(n), dc)


def told(claim: Claim) -> str:
    derived = "yes" if claim.derivation.derived else "not found"
    ended = "; ".join(note for note in claim.notes if "time budget" in note)
    return f"{claim.verdict}, z {claim.z:.1f}, made from the asset: {derived}; {ended}\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--side", type=int, default=256, help="cells along the grid of the reconstruction")
    parser.add_argument("--pixels", type=int, default=600, help="side of the views that give points")
    parser.add_argument("--seconds", type=float, default=600.0, help="time budget of each verification")
    parser.add_argument("--of", nargs="+", default=["marked", "original"], choices=["marked", "original"])
    parser.add_argument("--keep", type=Path, help="folder for the meshes")
    options = parser.parse_args()
    config = VerifyConfig(time_budget=options.seconds)
    for path in options.scenes:
        scene = mark_scene(path, configure("balanced"), seed=1)
        for name in options.of:
            model = scene.marked if name == "marked" else scene.original
            points, colors, normals = seen_points(model, make_rig(model, 40, options.pixels, options.pixels))
            cell = 1.2 * np.ptp(np.quantile(points, [0.002, 0.998], axis=0), axis=0).max() / options.side
            mesh = colored(poisson_mesh(points, normals, options.side), points, colors, 1.5 * cell)
            with tempfile.TemporaryDirectory() as folder:
                file = (options.keep or Path(folder)) / f"{path.stem}_{name}.ply"
                file.write_bytes(cloud_of(as_model(mesh), faces=1))
                suspect = read_suspect(file).model
            sys.stdout.write(f"{path.name} {name}, {len(suspect):,} corners: ")
            sys.stdout.write(told(verify_model(suspect, scene.opened, config).claim))
            sys.stdout.flush()
            views = [np.clip(render(suspect, camera), 0, 1) for camera in make_rig(suspect, 3, 800, 800)]
            sys.stdout.write("  three pictures of it: " + told(verify_images(views, scene.opened, config).claim))
            sys.stdout.flush()


if __name__ == "__main__":
    main()
