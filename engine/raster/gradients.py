"""Gradients of an image with respect to everything: Gaussians, colours or SH, and the camera."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.raster.geometry import padded
from engine.raster.lane_memory import aligned
from engine.raster.moments import MOMENTS, PAIR_NUMBERS, moments_scratch, pair_moments
from engine.raster.parameter_gradients import GRADIENT_SCRATCH, chunks_of, parameter_gradients
from engine.raster.projection import pack_lens
from engine.raster.settings import RasterSettings
from engine.raster.sh_kernels import SH_SCRATCH
from engine.raster.spherical_harmonics import sh_colors
from engine.raster.view import View, prepare_view
from engine.raster.workspace import Workspace, borrow_workspace

_NONE = np.zeros(0, dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Rendering:
    """An image (H, W, 3) and alpha (H, W) with what their gradient needs; made by `draw`.

    `own_colors`: the colours (N, 3) were given, not taken from the model's SH.
    """

    model: GaussianModel
    view: View
    colors: Float32
    own_colors: bool
    image: Float32
    alpha: Float32


@dataclass(frozen=True, eq=False)
class Gradients:
    """dL/d(parameter), each in the shape and dtype of the parameter."""

    means: Float32
    quats: Float32  # through the normalisation: orthogonal to the quaternion
    log_scales: Float32
    opacity_logits: Float32
    centers: Float32  # (2, N) by x and y of the projected centres, pixels, the projected shapes held
    colors: Float32  # (N, 3) by the view-dependent colours
    sh: Float32  # empty, (0, K, 3), when the colours were given
    viewmat: Float64  # of a camera without skew: the twelve numbers of the pose taken as free, the last row is 0
    K: Float64  # of such a camera: fx, fy, cx, cy, 0 elsewhere

    @classmethod
    def empty(cls, model: GaussianModel, *, with_sh: bool = True) -> "Gradients":
        """Uninitialised arrays for a model, to be reused from call to call (`out` of `backward`)."""
        n = len(model)
        shapes = {"means": (n, 3), "quats": (n, 4), "log_scales": (n, 3), "opacity_logits": (n,)}
        shapes |= {"centers": (2, n), "colors": (n, 3), "sh": (n if with_sh else 0, model.sh.shape[1], 3)}
        arrays = {name: np.empty(shape, dtype=np.float32) for name, shape in shapes.items()}
        return cls(**arrays, viewmat=np.zeros((4, 4)), K=np.zeros((3, 3)))


def draw(
    model: GaussianModel,
    camera: Camera,
    background: npt.ArrayLike = 0.0,
    settings: RasterSettings = RasterSettings(),
    colors: Float32 | None = None,
) -> Rendering:
    """Image of a model, keeping what `backward` needs; `colors` (N, 3) stand for those from the model's SH. See
    `render`."""
    view = prepare_view(model, camera, settings)
    used = sh_colors(model.sh, model.means, camera.position) if colors is None else colors
    used = np.ascontiguousarray(used, dtype=np.float32)
    if used.shape != (len(model), 3):
        raise InputError(f"colors has shape {used.shape}, expected ({len(model)}, 3)")
    image, alpha = view.render(used, background)
    return Rendering(model, view, used, colors is not None, image, alpha)


def backward(
    rendering: Rendering, cotangent: Float32, cotangent_alpha: Float32 | None = None, out: Gradients | None = None
) -> Gradients:
    """Gradients of a scalar L of the image, from (H, W, 3) dL/dimage and (H, W) dL/dalpha, 0 by default; the same bits
    whatever the number of threads.

    `out` are arrays to write to, see `Gradients.empty`: fresh memory costs as much as the computation. Gradients are 0
    for Gaussians that are not seen. Where a threshold holds (alpha clamped at 0.999, a colour at 0, alpha below 1/255,
    the end of a pixel) the derivative is that of the held branch. InputError if a shape is wrong, or discs were drawn.
    """
    model, view = rendering.model, rendering.view
    camera = view.camera
    if view.geometry.settings.antialiased:
        raise InputError("gradients of parameters are not those of antialiased Gaussians: draw without `antialiased`")
    if len(view.geometry.discs):
        raise InputError("discs (2DGS) have no gradients of geometry here; View.backward_colors has the colours'")
    cotangent = np.ascontiguousarray(cotangent, dtype=np.float32)
    if cotangent.shape != rendering.image.shape:
        raise InputError(f"cotangent has shape {cotangent.shape}, expected {rendering.image.shape}")
    if cotangent_alpha is None:
        cotangent_alpha = np.zeros(rendering.alpha.shape, dtype=np.float32)
    cotangent_alpha = np.ascontiguousarray(cotangent_alpha, dtype=np.float32)
    if cotangent_alpha.shape != rendering.alpha.shape:
        raise InputError(f"cotangent_alpha has shape {cotangent_alpha.shape}, expected {rendering.alpha.shape}")
    result = Gradients.empty(model, with_sh=not rendering.own_colors) if out is None else out
    if result.means.shape != model.means.shape:
        raise InputError(f"out is for {len(result.means)} Gaussians, the model has {len(model)}")
    with borrow_workspace() as work:
        totals = _parameter_gradients(rendering, _moments(rendering, cotangent, cotangent_alpha, work), result)
    _camera_gradients(camera, totals, result)
    return result


def _moments(rendering: Rendering, cotangent: Float32, cotangent_alpha: Float32, work: Workspace) -> Float32:
    """(pairs * PAIR_NUMBERS,) moments and colour sums of every pair."""
    geometry = rendering.view.geometry
    sums: Float32 = work.array("pairs", (len(geometry.ids) * PAIR_NUMBERS,))
    pictures = (rendering.image, rendering.alpha, cotangent, cotangent_alpha)
    flat = (array.reshape(-1) for array in (rendering.colors, *pictures))
    bench = work.tile_bench(moments_scratch(3))
    pair_moments(geometry.lists, (0,) * 3, (0,) * (MOMENTS + 3), *flat, sums, bench)
    return sums


def _parameter_gradients(rendering: Rendering, sums: Float32, result: Gradients) -> Float64:
    """Fill all but the camera's; returns the camera's sums."""
    geometry, model = rendering.view.geometry, rendering.model
    n, full = len(model), padded(model)
    chunks = chunks_of(len(full))
    into, colors = result, rendering.colors
    if n < len(full):
        into = Gradients.empty(full, with_sh=not rendering.own_colors)
        colors = np.concatenate([colors, np.zeros((len(full) - n, 3), dtype=np.float32)])
    by_chunk = np.empty((chunks, 32), dtype=np.float32)
    raw = tuple(array.reshape(-1) for array in (full.means, full.quats, full.log_scales, full.opacity_logits))
    names = ("means", "quats", "log_scales", "opacity_logits", "centers", "colors", "sh")
    out = (*(getattr(into, name).reshape(-1) for name in names), by_chunk)
    sh = _NONE if rendering.own_colors else full.sh.reshape(-1)
    shading = (sh, full.sh.shape[1], colors.reshape(-1), rendering.view.camera.position.astype(np.float32))
    lens = pack_lens(rendering.view.camera, geometry.settings)
    scratches = aligned((chunks, GRADIENT_SCRATCH)), aligned((chunks, SH_SCRATCH))
    parameter_gradients(raw, lens, sums, geometry.firsts, geometry.slots, shading, scratches, out)
    if into is not result:
        for name in names:
            getattr(result, name)[:] = into.centers[:, :n] if name == "centers" else getattr(into, name)[:n]
    return np.asarray(by_chunk.sum(axis=0, dtype=np.float64))


def _camera_gradients(camera: Camera, totals: Float64, result: Gradients) -> None:
    """Fill viewmat and K from the camera's sums."""
    R, t = camera.viewmat[:3, :3], camera.viewmat[:3, 3]
    position = totals[16:19]  # dL/d(camera centre), centre = -R^T t
    result.viewmat[:] = 0.0
    result.viewmat[:3, :3] = totals[:9].reshape(3, 3) - np.outer(t, position)
    result.viewmat[:3, 3] = totals[9:12] - R @ position
    result.K[:] = 0.0
    result.K[[0, 1, 0, 1], [0, 1, 2, 2]] = totals[12:16]
