"""The marks of one profile, looked at: key views, and views that did not shape the mark."""

import base64
import io
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np

from engine.errors import InputError
from engine.extras import load_extra
from engine.flows.embed.profiles import profile
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.bench.attacks import to_8_bit
from engine.lab.evaluate.marked_scene import mark_scene
from engine.lab.evaluate.study import Row
from engine.lab.sim.attacks import image_attack
from engine.lab.sim.multiscale_ssim import ms_ssim_distance
from engine.model import Float32, Float64
from engine.numerics.image_metrics import psnr, ssim
from engine.raster import render

__all__ = ["COMPARED_QUALITIES", "flip_map", "load_lpips", "look_at_mark", "picture_text"]

Distance = Callable[[Float32, Float32], float]

GAIN = 20.0
PATCH_SIDE = 160
"""Pixels of the square kept for the report: 2.4 degrees, about what is looked at at once."""
COMPARED_QUALITIES = (95, 75)
"""JPEGs with which the mark is compared: a careful export, and what web pages serve."""


def look_at_mark(
    path: str, profile_name: str, views: int, size: int, seed: int, lpips_weights: str | None = None
) -> list[Row]:
    """Mark a scene and measure how it looks against the unmarked renders.

    At the key views and at `views` outside the pose key, of `size` pixels a side (at least 176): one row a view
    (``kind`` "key" or "free"), and one with the worst patch of these as pictures.
    """
    perceived = None if lpips_weights is None else load_lpips(lpips_weights)
    config = profile(profile_name, landmark_views=0)
    scene = mark_scene(path, config, seed=seed)
    about = {"scene": Path(path).name, "profile": profile_name, "target_db": config.psnr_db, "target_ssim": config.ssim}
    jitter = np.random.default_rng((seed, 8)).random((views, 4))
    cameras = {"key": scene.opened.cameras, "free": make_rig(scene.original, views, size, size, jitter=jitter)}
    rows: list[Row] = []
    worst: Row = {"patch_flip": -1.0}
    for kind, own in cameras.items():
        for number, camera in enumerate(own):
            plain, marked = render(scene.original, camera), render(scene.marked, camera)
            row = {**about, "kind": kind, "view": number, **_fidelity(plain, marked)}
            if kind == "free":
                errors = flip_map(plain, marked)
                row |= _perception(plain, marked, errors, perceived)
                worst = max(worst, _worst_patch(plain, marked, errors), key=lambda patch: float(patch["patch_flip"]))
            rows.append(row)
    return [*rows, {**about, "kind": "picture", **worst}]


def _fidelity(plain: Float32, marked: Float32) -> dict[str, float]:
    levels = np.abs(np.rint(255 * (to_8_bit(marked) - to_8_bit(plain))))
    return {
        "psnr": psnr(plain, marked),
        "ssim": ssim(plain, marked),
        "changed_share": float((levels > 0).any(axis=2).mean()),
        "largest_levels": int(levels.max()),
    }


def _perception(
    plain: Float32, marked: Float32, errors: Float32, perceived: Distance | None
) -> dict[str, float | None]:
    row = {
        "ms_ssim": 1.0 - ms_ssim_distance(plain, marked),
        "flip": float(errors.mean()),
        "flip_99": float(np.quantile(errors, 0.99)),
        "lpips": None if perceived is None else perceived(plain, marked),
    }
    for quality in COMPARED_QUALITIES:
        stored = image_attack("jpeg").apply(to_8_bit(plain), quality)
        row[f"jpeg{quality}_psnr"] = psnr(plain, stored)
        errors = flip_map(plain, stored)
        row[f"jpeg{quality}_flip"] = float(errors.mean())
        row[f"jpeg{quality}_flip_99"] = float(np.quantile(errors, 0.99))
        row[f"jpeg{quality}_lpips"] = None if perceived is None else perceived(plain, stored)
    return row


def flip_map(a: Float32, b: Float32) -> Float32:
    """(H, W) FLIP at 67 pixels a degree, a desktop screen from 70 cm (Andersson et al., HPG 2020).

    0 where nothing is seen to differ, at most 1. The pictures, (H, W, 3) sRGB, are clipped to 0..1. An InputError where
    the package flip-evaluator is not installed.
    """
    flip_evaluator = load_extra("flip_evaluator", "lab", "FLIP")
    pair = [np.ascontiguousarray(np.clip(image, 0, 1), dtype=np.float32) for image in (a, b)]
    errors: Float32 = flip_evaluator.evaluate(*pair, "LDR", applyMagma=False, computeMeanError=False)[0][..., 0]
    return errors


def load_lpips(weights: str) -> Distance:
    """LPIPS, the distance of Zhang et al. (CVPR 2018), version 0.1 on AlexNet, of pictures (H, W, 3) in 0..1.

    The file holds torchvision's AlexNet state dict (``features.0.weight``, ...), as ``torch.save`` writes it; the
    linear layers come with the optional package `lpips`. An InputError where the package is not installed, or the file
    is missing or holds something else.
    """
    try:
        import lpips
        import torch
    except ModuleNotFoundError as error:
        raise InputError(f"--lpips-weights needs the packages lpips and torchvision: {error}") from None
    network = lpips.LPIPS(net="alex", pnet_rand=True, verbose=False)
    try:
        stored = torch.load(weights, map_location="cpu", weights_only=True)
        # slice3.6.weight is features.6.weight
        state = {name: stored["features." + name.split(".", 1)[1]] for name in network.net.state_dict()}
        network.net.load_state_dict(state)
    except FileNotFoundError:
        raise InputError(f"{weights}: no such file") from None
    except (KeyError, TypeError, RuntimeError, pickle.UnpicklingError, EOFError):
        raise InputError(f"{weights}: not the weights of torchvision's AlexNet") from None

    def distance(a: Float32, b: Float32) -> float:
        images = (np.ascontiguousarray(np.clip(image, 0, 1).transpose(2, 0, 1)) for image in (a, b))
        with torch.no_grad():
            return float(network(*(torch.from_numpy(image)[None] for image in images), normalize=True))

    return distance


def _worst_patch(plain: Float32, marked: Float32, errors: Float32) -> Row:
    """The square of a view in which FLIP sees the mark most, pixel by pixel."""
    means = sliding_mean(errors, PATCH_SIDE)
    top, left = np.unravel_index(means.argmax(), means.shape)
    plain, marked = (np.clip(image[top:, left:][:PATCH_SIDE, :PATCH_SIDE], 0, 1) for image in (plain, marked))
    shown = {"original": plain, "marked": marked, "difference": np.float32(GAIN) * np.abs(plain - marked)}
    return {"patch_flip": float(means[top, left]), **{name: picture_text(each) for name, each in shown.items()}}


def sliding_mean(plane: Float32, side: int) -> Float64:
    """(H - side + 1, W - side + 1) mean of the square that begins at each pixel; one as large as fits, if `side` does
    not."""
    rows, columns = min(side, plane.shape[0]), min(side, plane.shape[1])
    sums = np.pad(plane.astype(np.float64).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    inside = sums[rows:, columns:] - sums[:-rows, columns:] - sums[rows:, :-columns] + sums[:-rows, :-columns]
    return np.asarray(inside / (rows * columns))


def picture_text(image: Float32) -> str:
    """A picture as base64 of a PNG file, so that a row can hold it."""
    from PIL import Image

    out = io.BytesIO()
    content = np.rint(255 * np.clip(image, 0, 1)).astype(np.uint8)
    Image.fromarray(content).save(out, "PNG")
    return base64.b64encode(out.getvalue()).decode()
