"""One picture of one model: geometry and colours in one go, nothing kept."""

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Camera, Float32, GaussianModel
from engine.raster.geometry import build_geometry
from engine.raster.settings import RasterSettings
from engine.raster.spherical_harmonics import evaluate
from engine.raster.view import blend_colors
from engine.raster.workspace import borrow_workspace

__all__ = ["render", "render_depth"]


def render(
    model: GaussianModel, camera: Camera, background: npt.ArrayLike = 0.0, settings: RasterSettings = RasterSettings()
) -> Float32:
    """(H, W, 3) float32 image of a model, at least 0, not clipped at 1, over a background of one number or three.
    InputError if a shape is wrong or the image is too large."""
    behind = np.zeros(3, dtype=np.float32)
    try:
        behind[:] = background
    except ValueError as error:
        raise InputError("background must be one number or three") from error
    with borrow_workspace() as work:
        geometry, sizes = build_geometry(model, camera, settings, work, keep=False)
        colors = work.array("colors", (len(model), 3))
        evaluate(model.sh, model.means, camera.position.astype(np.float32), sizes, colors)
        image, _, _ = blend_colors(geometry, colors, behind, work)
    return image


def render_depth(
    model: GaussianModel, camera: Camera, background: npt.ArrayLike = 0.0, settings: RasterSettings = RasterSettings()
) -> tuple[Float32, Float32, Float32]:
    """Image (H, W, 3) as `render`'s, accumulated opacity (H, W) and expected depth (H, W), in one pass over the pixels.

    Depth is the mean camera z of what is blended, weighted by blending weight, scene units; 0 where the opacity is 0.
    """
    behind = np.zeros(4, dtype=np.float32)
    behind[:3] = background
    row = camera.viewmat[2]
    with borrow_workspace() as work:
        geometry, sizes = build_geometry(model, camera, settings, work, keep=False)
        colors, shades = work.array("colors", (len(model), 3)), work.array("shades", (len(model), 4))
        evaluate(model.sh, model.means, camera.position.astype(np.float32), sizes, colors)
        shades[:, :3] = colors
        shades[:, 3] = model.means @ row[:3].astype(np.float32) + np.float32(row[3])
        blended, alpha, _ = blend_colors(geometry, shades, behind, work)
    depth = blended[..., 3] / np.maximum(alpha, np.finfo(np.float32).tiny)
    return np.ascontiguousarray(blended[..., :3]), alpha, depth.astype(np.float32)
