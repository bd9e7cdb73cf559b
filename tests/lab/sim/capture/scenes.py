"""A small scene with photos of it, and a COLMAP model of those photos on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from engine.model import Camera, Float32, GaussianModel, look_at
from engine.numerics.similarity import rotation_to_quaternion
from engine.raster import render


def shell(count: int = 400, seed: int = 0) -> GaussianModel:
    """Colored Gaussians on a ball."""
    rng = np.random.default_rng(seed)
    normal = rng.standard_normal((count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    quats = rng.standard_normal((count, 4))
    sh = np.zeros((count, 4, 3))
    sh[:, 0] = np.sin(3 * normal + [0, 1, 2])
    return GaussianModel(
        normal.astype(np.float32),
        np.log(rng.uniform(0.08, 0.2, (count, 3))).astype(np.float32),
        (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        np.full(count, 2.0, np.float32),
        sh.astype(np.float32),
    )


def orbit(count: int, width: int = 64, height: int = 48) -> list[Camera]:
    """Cameras around the ball."""
    angles = np.linspace(0.0, 2 * np.pi, count, endpoint=False)
    eyes = [(3.5 * np.cos(a), 0.8 * np.sin(2 * a), 3.5 * np.sin(a)) for a in angles]
    return [look_at(eye, (0.0, 0.0, 0.0), (0.0, -1.0, 0.0), float(width), width, height) for eye in eyes]


def photos(model: GaussianModel, cameras: list[Camera]) -> list[Float32]:
    return [np.clip(render(model, camera), 0.0, 1.0) for camera in cameras]


def write_colmap(folder: Path, model: GaussianModel, cameras: list[Camera], lens: str = "") -> Path:
    """The photos as PNG, and the reconstruction that would have found the model's centers."""
    images = folder / "images"
    images.mkdir(parents=True)
    first = cameras[0]
    K = first.K
    pinhole = f"PINHOLE {first.width} {first.height} {K[0, 0]} {K[1, 1]} {K[0, 2]} {K[1, 2]}"
    (folder / "cameras.txt").write_text(f"1 {lens or pinhole}\n")
    lines = []
    for k, (camera, photo) in enumerate(zip(cameras, photos(model, cameras), strict=True)):
        Image.fromarray(np.round(photo * 255).astype(np.uint8)).save(images / f"p{k:02}.png")
        quat = rotation_to_quaternion(camera.viewmat[:3, :3])
        numbers = " ".join(repr(float(v)) for v in (*quat, *camera.viewmat[:3, 3]))
        lines += [f"{k + 1} {numbers} 1 p{k:02}.png", ""]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    shades = np.clip(np.round(255 * (0.5 + 0.282 * model.sh[:, 0])), 0, 255).astype(int)
    rows = [
        f"{k} {p[0]} {p[1]} {p[2]} {c[0]} {c[1]} {c[2]} 0.5 1 7 2 8"
        for k, (p, c) in enumerate(zip(model.means, shades, strict=True))
    ]
    (folder / "points3D.txt").write_text("# comment\n" + "\n".join(rows) + "\n")
    return images
