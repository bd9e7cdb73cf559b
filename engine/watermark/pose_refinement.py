"""Close in on the camera of a picture by comparing brightness with fresh renders (robust Gauss-Newton).

One render with depth gives the image and, with the depth, how every pixel moves with pose and focal length: an
iteration costs one render, not one for each unknown. The motion of half-transparent edges is not quite that of
their mean depth; this slows convergence a little and does not shift the optimum, where the residual is noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.model import Camera, Float32, Float64, GaussianModel
from engine.numerics.resampling import smooth
from engine.raster import render_depth
from engine.watermark.brightness_fit import robust_scale
from engine.watermark.features import luma
from engine.watermark.pose import FREE_ALL, FREE_CENTERED, moved, pixel_motion

__all__ = ["PoseFit", "RefinementConfig", "refine_pose"]

_CLIPPED = 0.985
_LEAST_SAMPLES = 200


@dataclass(frozen=True)
class RefinementConfig:
    """Knobs of `refine_pose`.

    Parameters
    ----------
    sides : tuple of int
        Longest side of the renders, pixels, coarse to fine; the last is a limit.
    blurs : tuple of float
        Blur at each of them, pixels.
    rounds : tuple of int
        Most iterations at each of them.
    stop_pixels : tuple of float
        A step that moves the picture's pixels by less than this (root mean square) ends that resolution.
    samples : int
        Most pixels used, the steepest.
    least_alpha : float
        Only pixels at least this opaque: what lies behind the model in the picture is not known.
    crop_gain : float
        A free principal point must lower the residual to this fraction.
    """

    sides: tuple[int, ...] = (400, 400, 1000)
    blurs: tuple[float, ...] = (2.0, 0.8, 0.8)
    rounds: tuple[int, ...] = (5, 5, 4)
    stop_pixels: tuple[float, ...] = (0.15, 0.05, 0.01)
    samples: int = 60_000
    least_alpha: float = 0.9
    crop_gain: float = 0.97


@dataclass(frozen=True, eq=False)
class PoseFit:
    """A camera and how well its view explains the picture.

    Parameters
    ----------
    camera : Camera
        At the picture's size.
    rms : float
        Robust residual of brightness, image units.
    correlation : float
        Of both images' brightness on the steep pixels, -1..1.
    renders : int
        Number of renders it took.
    """

    camera: Camera
    rms: float
    correlation: float
    renders: int


def refine_pose(
    model: GaussianModel, image: Float32, camera: Camera, config: RefinementConfig = RefinementConfig()
) -> PoseFit | None:
    """Fit pose, focal length, exposure gain and offset.

    Parameters
    ----------
    model : GaussianModel
        The unmarked reference.
    image : (h, w, 3) float32
        The picture, 0..1.
    camera : Camera
        Start, at the picture's size; off by a few pixels at most.
    config : RefinementConfig

    Returns
    -------
    PoseFit or None
        None when nothing opaque lies in view.
    """
    grey, renders = luma(image), 0
    fit: PoseFit | None = None
    stages = list(zip(config.sides, config.blurs, config.rounds, config.stop_pixels, strict=True))
    for side, blur, rounds, stop in stages:
        fit = _refine_at(model, grey, camera, side, blur, rounds, stop, FREE_CENTERED, config)
        if fit is None:
            return None
        camera, renders = fit.camera, renders + fit.renders
    assert fit is not None
    side, blur, _, stop = stages[-2]
    centered = _refine_at(model, grey, camera, side, blur, 1, stop, FREE_CENTERED, config)
    shifted = _refine_at(model, grey, camera, side, blur, 4, stop, FREE_ALL, config)
    renders += sum(f.renders for f in (centered, shifted) if f is not None)
    if shifted and centered and shifted.rms < config.crop_gain * centered.rms:
        side, blur, rounds, stop = stages[-1]
        finer = _refine_at(model, grey, shifted.camera, side, blur, rounds, stop, FREE_ALL, config)
        if finer is not None:
            renders += finer.renders
            if finer.rms < config.crop_gain * fit.rms:
                fit = finer
    return PoseFit(fit.camera, fit.rms, fit.correlation, renders)


def _refine_at(
    model: GaussianModel,
    grey: Float32,
    camera: Camera,
    side: int,
    blur: float,
    rounds: int,
    stop: float,
    free: int,
    config: RefinementConfig,
) -> PoseFit | None:
    """Gauss-Newton at one resolution; the fit belongs to the last camera that was rendered."""
    shrink = min(1.0, side / max(camera.width, camera.height))
    small = camera.resized(max(8, round(camera.width * shrink)), max(8, round(camera.height * shrink)))
    seen = smooth(_shrunk(grey, small.width, small.height), blur)
    best: PoseFit | None = None
    trial, tone, renders = small, None, 0
    for _ in range(rounds + 1):
        image, alpha, depth = render_depth(model, trial)
        renders += 1
        step = _measure(smooth(luma(image), blur), alpha, depth, seen, trial, free, tone, config)
        if step is None:
            break
        if best is not None and step.rms > 1.02 * best.rms:
            break  # it got worse: the camera before was better
        best = PoseFit(_at_size(trial, camera), step.rms, step.correlation, renders)
        if step.motion < stop or renders > rounds:
            break
        trial, tone = moved(trial, step.step), step.tone
    return None if best is None else PoseFit(best.camera, best.rms, best.correlation, renders)


@dataclass(frozen=True, eq=False)
class _Step:
    step: Float64
    tone: tuple[float, float]
    rms: float
    correlation: float
    motion: float


def _measure(
    base: Float32,
    alpha: Float32,
    depth: Float32,
    seen: Float32,
    camera: Camera,
    free: int,
    tone: tuple[float, float] | None,
    config: RefinementConfig,
) -> _Step | None:
    """One Gauss-Newton step from a render and the picture."""
    gy, gx = (np.asarray(g) for g in np.gradient(base))
    energy = np.where((alpha > config.least_alpha) & (seen < _CLIPPED), gx * gx + gy * gy, 0.0)
    usable = int(np.count_nonzero(energy))
    if usable < _LEAST_SAMPLES:
        return None
    keep = min(config.samples, max(_LEAST_SAMPLES, usable // 2))
    chosen = np.sort(np.argpartition(energy.ravel(), energy.size - keep)[-keep:])
    rows, columns = np.divmod(chosen, camera.width)
    r, s = base.ravel()[chosen].astype(np.float64), seen.ravel()[chosen].astype(np.float64)
    gain, offset = tone if tone is not None else _tone(r, s)
    z = depth.ravel()[chosen].astype(np.float64)
    x = (columns + 0.5 - camera.K[0, 2]) / camera.K[0, 0] * z
    y = (rows + 0.5 - camera.K[1, 2]) / camera.K[1, 1] * z
    motion = pixel_motion(camera, np.stack([x, y, z], axis=1), free)  # (P, 2, free)
    slope = np.stack([gx.ravel()[chosen], gy.ravel()[chosen]], axis=1).astype(np.float64)
    residual = s - gain * r - offset
    spread = robust_scale(residual)
    weight = 1.0 / (1.0 + np.square(residual / (2.5 * spread)))
    # A pixel's content moves along: base(x) becomes base(x - motion).
    design = np.concatenate(
        [-gain * np.einsum("pi,pik->pk", slope, motion), r[:, None], np.ones((keep, 1))], axis=1
    )
    weighted = design * weight[:, None]
    normal = weighted.T @ design
    normal[np.diag_indices_from(normal)] *= 1.0 + 1e-7
    normal[np.diag_indices_from(normal)] += 1e-12
    delta = np.linalg.solve(normal, weighted.T @ residual)
    shift = motion @ delta[:-2]  # (P, 2) pixels
    both = np.std(r) * np.std(s)
    correlation = float(np.mean((r - r.mean()) * (s - s.mean())) / both) if both > 1e-12 else 0.0
    return _Step(
        delta[:-2], (gain + float(delta[-2]), offset + float(delta[-1])), spread, correlation,
        float(np.sqrt(np.mean(np.square(shift).sum(axis=1)))),
    )  # fmt: skip


def _tone(r: Float64, s: Float64) -> tuple[float, float]:
    low_r, high_r = np.quantile(r, [0.2, 0.8])
    low_s, high_s = np.quantile(s, [0.2, 0.8])
    gain = float(np.clip((high_s - low_s) / max(high_r - low_r, 1e-3), 0.3, 3.0))
    return gain, float(np.median(s) - gain * np.median(r))


def _shrunk(grey: Float32, width: int, height: int) -> Float32:
    import cv2

    if grey.shape == (height, width):
        return grey
    return np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA), dtype=np.float32)


def _at_size(camera: Camera, like: Camera) -> Camera:
    return camera.resized(like.width, like.height)
