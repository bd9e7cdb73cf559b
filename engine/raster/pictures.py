"""One picture of one model: geometry and colours in one go, nothing kept."""

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.jit import parallel_section
from engine.raster.geometry import build_geometry
from engine.raster.settings import RasterSettings
from engine.raster.spherical_harmonics import evaluate, sh_colors
from engine.raster.view import blend_colors, prepare_view
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
    with parallel_section(), borrow_workspace() as work:
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
    view = prepare_view(model, camera, settings)
    colors = np.empty((len(model), 4), dtype=np.float32)
    colors[:, :3] = sh_colors(model.sh, model.means, camera.position)
    colors[:, 3] = view.depth_of_all
    blended, alpha = view.render(colors, behind)
    depth = blended[..., 3] / np.maximum(alpha, np.finfo(np.float32).tiny)
    return np.ascontiguousarray(blended[..., :3]), alpha, depth.astype(np.float32)
