"""The marks of one profile, looked at: key views and views that had no part in shaping the mark."""

import base64
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from engine.errors import InputError
from engine.evaluate.bench.attacks import to_8_bit
from engine.evaluate.marked_scene import MarkedScene, mark_scene
from engine.evaluate.study import Row
from engine.model import Camera, Float32
from engine.numerics.image_metrics import difference_picture, ms_ssim_distance, psnr, ssim
from engine.pipeline.profiles import profile
from engine.pipeline.rigs import make_rig
from engine.raster import render
from engine.sim.attacks import image_attack

__all__ = ["COMPARED_QUALITIES", "flip_map", "look_at_mark", "picture_text"]

GAIN = 20.0
PICTURE_SIDE = 480
KEPT_QUALITY = 90
"""WebP quality of the pictures kept for the report; nothing is measured on them."""
COMPARED_QUALITIES = (95, 75)
"""JPEGs beside which the mark is put: a careful export, and what web pages serve."""


def look_at_mark(
    path: str, profile_name: str, views: int, size: int, seed: int, lpips_weights: str | None = None
) -> list[Row]:
    """Mark a scene and measure how it looks against the unmarked renders.

    Parameters
    ----------
    path : str
        Of a model.
    views : int
        Views outside the pose key.
    size : int
        Of those views, pixels a side, at least 176.
    seed : int
        Of key and views.

    Returns
    -------
    list of dict
        One row a view (``kind`` "key" or "free"), and one with the worst view as pictures.
    """
    perceived = None
    if lpips_weights is not None:
        from engine.evaluate.perceptual.lpips_distance import load_lpips

        perceived = load_lpips(lpips_weights)
    config = profile(profile_name, landmark_views=0)
    scene = mark_scene(path, config, seed=seed)
    about = {"scene": Path(path).name, "profile": profile_name, "target_db": config.psnr_db}
    about["target_ssim"] = config.ssim
    jitter = np.random.default_rng((seed, 8)).random((views, 4))
    free = make_rig(scene.original, views, size, size, jitter=jitter)
    rows: list[Row] = []
    for kind, cameras in (("key", scene.opened.cameras), ("free", free)):
        for number, camera in enumerate(cameras):
            plain, marked = render(scene.original, camera), render(scene.marked, camera)
            row = {"kind": kind, "view": number, **_fidelity(plain, marked)}
            if kind == "free":
                row |= _perception(plain, marked, perceived)
            rows.append({**about, **row})
    cameras = [*scene.opened.cameras, *free]
    worst = int(np.argmin([row["psnr"] for row in rows]))
    return [*rows, {**about, "kind": "picture", "of": rows[worst]["kind"], **_pictures(scene, cameras[worst])}]


def _fidelity(plain: Float32, marked: Float32) -> dict[str, Any]:
    levels = np.abs(np.rint(255 * (to_8_bit(marked) - to_8_bit(plain))))
    return {
        "psnr": psnr(plain, marked),
        "ssim": ssim(plain, marked),
        "changed_share": float((levels > 0).any(axis=2).mean()),
        "largest_levels": int(levels.max()),
    }


def _perception(
    plain: Float32, marked: Float32, perceived: Callable[[Float32, Float32], float] | None
) -> dict[str, Any]:
    errors = flip_map(plain, marked)
    row = {
        "ms_ssim": 1.0 - ms_ssim_distance(plain, marked),
        "flip": float(errors.mean()),
        "flip_999": float(np.quantile(errors, 0.999)),
        "lpips": None if perceived is None else perceived(plain, marked),
    }
    for quality in COMPARED_QUALITIES:
        stored = image_attack("jpeg").apply(to_8_bit(plain), quality)
        row[f"jpeg{quality}_psnr"] = psnr(plain, stored)
        row[f"jpeg{quality}_flip"] = float(flip_map(plain, stored).mean())
        row[f"jpeg{quality}_lpips"] = None if perceived is None else perceived(plain, stored)
    return row


def flip_map(a: Float32, b: Float32) -> Float32:
    """FLIP of each pixel at 67 pixels a degree, a desktop screen from 70 cm (Andersson et al., HPG 2020).

    Parameters
    ----------
    a, b : (H, W, 3) float32
        sRGB, 0 to 1, clipped first.

    Returns
    -------
    (H, W) float32
        0 where nothing is seen to differ, at most 1.

    Raises
    ------
    InputError
        If the package flip-evaluator is not installed.
    """
    try:
        import flip_evaluator
    except ModuleNotFoundError:
        raise InputError("FLIP needs the package flip-evaluator: pip install 'mark3dgs[evaluate]'") from None
    pair = [np.ascontiguousarray(np.clip(image, 0, 1), dtype=np.float32) for image in (a, b)]
    errors: Float32 = flip_evaluator.evaluate(*pair, "LDR", applyMagma=False, computeMeanError=False)[0][..., 0]
    return errors


def _pictures(scene: MarkedScene, camera: Camera) -> dict[str, str]:
    """Original, marked and amplified difference at one view, rendered smaller."""
    small = camera.resized(PICTURE_SIDE, round(PICTURE_SIDE * camera.height / camera.width))
    plain, marked = render(scene.original, small), render(scene.marked, small)
    return {
        "original": picture_text(plain),
        "marked": picture_text(marked),
        "difference": picture_text(difference_picture(plain, marked, GAIN)),
    }


def picture_text(image: Float32) -> str:
    """A picture as base64 of a WebP file, so that a row can hold it."""
    from PIL import Image

    out = io.BytesIO()
    content = np.rint(255 * np.clip(image, 0, 1)).astype(np.uint8)
    Image.fromarray(content).save(out, "WEBP", quality=KEPT_QUALITY)
    return base64.b64encode(out.getvalue()).decode()
