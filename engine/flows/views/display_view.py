"""A model, or a picture of it, as people are shown it: from where, and what was laid over what."""

import numpy as np
from PIL import Image

from engine.flows.views.camera_rig import make_rig
from engine.flows.views.config import CONFIG
from engine.model import Bool, Camera, Float32, GaussianModel
from engine.pictures.alignment.background import find_background
from engine.pictures.alignment.planar import Alignment, align_image
from engine.raster import render

_CONFIG = CONFIG.display


def choose_view(model: GaussianModel, width: int, height: int) -> Camera:
    """The view that shows most of a model, of a few regular ones; it follows from the model alone, never a key.

    Tried on a thinned-out model in tiny pictures: what counts is how much of the picture is filled, and how much
    there is to see in it.
    """
    thin = model.take(np.arange(0, len(model), max(1, len(model) // _CONFIG.trial_gaussians)))
    # The gaps that thinning leaves are filled.
    wider = 0.5 * np.log(len(model) / len(thin))
    thin = thin.with_(log_scales=thin.log_scales + np.float32(wider))
    short = min(width, height)  # a rig fits the model to the width of its pictures
    rig = [_reshaped(camera, width, height) for camera in make_rig(thin, _CONFIG.trial_views, short, short)]
    shrink = _CONFIG.trial_size / max(width, height)
    scores = []
    for camera in rig:
        small = camera.resized(max(1, round(width * shrink)), max(1, round(height * shrink)))
        image = np.clip(render(thin, small, 0.5), 0.0, 1.0)
        filled = (np.abs(image - 0.5).max(axis=2) > 0.02).mean()
        scores.append(float(filled) + float(image.std()))
    return with_all(thin, rig[int(np.argmax(scores))])


def with_all(model: GaussianModel, camera: Camera) -> Camera:
    """The camera with a focal length at which it shows all of an object; of a room it is left as it is."""
    seen = model.means[model.opacity_logits > _CONFIG.faint].astype(np.float64)
    x, y, z = (seen @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]).T
    if not len(z) or (z <= 0).mean() > _CONFIG.behind:
        return camera
    x, y, z = x[z > 0], y[z > 0], z[z > 0]
    across = np.maximum(camera.K[0, 0] * abs(x) / camera.width, camera.K[1, 1] * abs(y) / camera.height) / z
    fitting = 0.5 * _CONFIG.margin / float(np.quantile(across, _CONFIG.whole))
    return widened(camera, max(_CONFIG.widest, min(1.0, fitting)))


def widened(camera: Camera, factor: float) -> Camera:
    """The camera with so many times the focal length."""
    K = camera.K.copy()
    K[0, 0], K[1, 1] = factor * K[0, 0], factor * K[1, 1]
    return Camera(camera.viewmat, K, camera.width, camera.height)


def _reshaped(camera: Camera, width: int, height: int) -> Camera:
    K = camera.K.copy()
    K[0, 2], K[1, 2] = width / 2, height / 2
    return Camera(camera.viewmat, K, width, height)


def lay_over(picture: Float32, image: Float32, alpha: Float32) -> tuple[Float32, Bool] | None:
    """A suspect picture in the pixels of the asset's render, less what shines through from behind, and where it can be
    compared; None where it cannot be laid over it."""
    height, width = alpha.shape
    small = to_picture(picture)
    if abs(width / height - small.width / small.height) < _CONFIG.same_shape:
        small = small.resize((width, height), reducing_gap=2.0)
    best: Alignment | None = None
    for hand in (1, -1):  # as it is, and turned over left to right
        faced = np.asarray(small, dtype=np.float32)[:, ::hand] / np.float32(255.0)
        behind = find_background(faced, alpha) if faced.shape == image.shape else None
        fit = align_image(image, faced if behind is None else faced - behind.through)
        if fit is not None and (best is None or fit.correlation > best.correlation):
            best = fit
        if best is not None and best.correlation > _CONFIG.sure_correlation:
            break
    return None if best is None else (best.warped, best.mask)


def to_picture(image: Float32, longest: int | None = None) -> Image.Image:
    """A picture of (H, W, 3) floats in 0..1, no side longer than `longest` pixels."""
    picture = Image.fromarray(np.round(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8))
    if longest is not None:
        picture.thumbnail((longest, longest), reducing_gap=2.0)
    return picture
