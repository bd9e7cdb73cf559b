"""One picture of one model: geometry and colours in one go, nothing kept."""

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.jit import parallel_section
from engine.raster.geometry import build_geometry
from engine.raster.settings import RasterSettings
from engine.raster.spherical_harmonics import evaluate, sh_colors
from engine.raster.view import blend_colors, checked_impact, prepare_view
from engine.raster.workspace import borrow_workspace

__all__ = ["render", "render_depth"]


def render(
    model: GaussianModel,
    camera: Camera,
    background: npt.ArrayLike = 0.0,
    settings: RasterSettings = RasterSettings(),
    impact: Float32 | None = None,
) -> Float32:
    """Image of a model.

    Parameters
    ----------
    camera : Camera
        H x W pixels.
    background : scalar or (3,), optional
        Colour behind everything.
    settings : RasterSettings, optional
        Definition of the image.
    impact : (N,) float32, optional
        W^freq of Eq 8, needed with ``settings.impact_stop``.

    Returns
    -------
    (H, W, 3) float32
        At least 0, not clipped at 1.

    Raises
    ------
    InputError
        If a shape is wrong or the image is too large.
    """
    behind = np.zeros(3, dtype=np.float32)
    try:
        behind[:] = background
    except ValueError as error:
        raise InputError("background must be one number or three") from error
    weights = checked_impact(impact, len(model), settings)
    with parallel_section(), borrow_workspace() as work:
        geometry, sizes = build_geometry(model, camera, settings, work, keep=False)
        colors = work.array("colors", (len(model), 3))
        evaluate(model.sh, model.means, camera.position.astype(np.float32), sizes, colors)
        image, _, _ = blend_colors(geometry, colors, behind, weights, work)
    return image


def render_depth(
    model: GaussianModel, camera: Camera, background: npt.ArrayLike = 0.0, settings: RasterSettings = RasterSettings()
) -> tuple[Float32, Float32, Float32]:
    """Image, accumulated opacity and expected depth of a model, in one pass over the pixels.

    Parameters
    ----------
    model, camera, background, settings
        As for `render`.

    Returns
    -------
    image : (H, W, 3) float32
    alpha : (H, W) float32
    depth : (H, W) float32
        Mean camera z of what is blended, weighted by blending weight, scene units; 0 where alpha is 0.
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
