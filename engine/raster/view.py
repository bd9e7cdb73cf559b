"""A model seen by a camera with its geometry frozen: images of any colours, and their exact gradient."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.kernels.thread_crew import thread_count
from engine.model import Camera, Float32, GaussianModel, Int32
from engine.raster.backward import WEIGHT_SUMS, backward_scratch, gather_sums, pair_sums, pair_width
from engine.raster.forward import blend_tiles, forward_scratch
from engine.raster.geometry import Geometry, build_geometry
from engine.raster.settings import EarlyStop, RasterSettings
from engine.raster.spherical_harmonics import evaluate
from engine.raster.workspace import Workspace, borrow_workspace

_WIDTHS = (1, 3, 4)
"""Numbers of channels that kernels are compiled for; two are padded to three, and more are not drawn at once."""


def width_of(channels: int) -> int:
    """Of the kernels that draw 1 to 4 channels."""
    return next(width for width in _WIDTHS if width >= channels)


def widened(array: Float32, width: int) -> Float32:
    """Channels of the last axis as C-contiguous float32, with zeros up to the width."""
    missing = width - array.shape[-1]
    if missing:
        array = np.concatenate([array, np.zeros((*array.shape[:-1], missing), dtype=np.float32)], axis=-1)
    return np.ascontiguousarray(array, dtype=np.float32)


def blend_colors(
    geometry: Geometry, colors: Float32, background: Float32, work: Workspace, tau: float | None = None
) -> tuple[Float32, Float32, int]:
    """Image (H, W, C) and alpha (H, W) of colours (N, C) with C a compiled width; and fragments evaluated.

    With `tau` the last channel is W of Eq 8.
    """
    camera, channels = geometry.camera, colors.shape[1]
    image = np.empty((camera.height, camera.width, channels), dtype=np.float32)
    alpha = np.empty((camera.height, camera.width), dtype=np.float32)
    evaluated = work.array("evaluated", (len(geometry.starts) - 1,), np.int64)
    bench = work.tile_bench(forward_scratch(channels))
    out = image.reshape(-1), alpha.reshape(-1), evaluated
    at = None if tau is None else np.float32(tau)
    blend_tiles(geometry.lists, (0,) * channels, colors.reshape(-1), background, *out, bench, at)
    return image, alpha, 16 * int(evaluated.sum())


@dataclass(frozen=True, eq=False)
class View:
    """Frozen geometry of one model and camera; made by `prepare_view`.

    Holds 32 bytes a Gaussian, 8 bytes a visible one and 8 bytes a (tile, Gaussian) pair: about 30 MB for a real scene
    of 500k Gaussians at 1 megapixel. It keeps no reference to the model.
    """

    geometry: Geometry

    @property
    def camera(self) -> Camera:
        """The camera."""
        return self.geometry.camera

    @property
    def visible(self) -> Int32:
        """(V,) int32 indices of the Gaussians that may touch the image, nearest first."""
        return self.geometry.visible

    def render(
        self, colors: Float32, background: npt.ArrayLike | None = None, early: EarlyStop | None = None
    ) -> tuple[Float32, Float32]:
        """Blend colours front to back (Eq 3): image (H, W, C) and accumulated opacity (H, W), 0 to 1.

        `colors` (N, C) float32, one per Gaussian of the model, C = 1 to 4 (3 with an `early` stop);
        `background` a scalar or (C,), 0 by default. InputError if a shape is wrong.
        """
        colors = np.asarray(colors)
        if colors.ndim != 2 or len(colors) != self.geometry.count or not 1 <= colors.shape[1] <= _WIDTHS[-1]:
            raise InputError(f"colors has shape {colors.shape}, expected ({self.geometry.count}, 1 to {_WIDTHS[-1]})")
        channels = colors.shape[1]
        behind = np.zeros(channels, dtype=np.float32)
        try:
            behind[:] = 0.0 if background is None else background
        except ValueError as error:
            raise InputError(f"background must be one number or {channels}") from error
        if early is not None:
            return self._stopped(colors, behind, early)
        width = width_of(channels)
        with borrow_workspace() as work:
            image, alpha, _ = blend_colors(self.geometry, widened(colors, width), widened(behind, width), work)
        return np.ascontiguousarray(image[..., :channels]), alpha

    def _stopped(self, colors: Float32, behind: Float32, early: EarlyStop) -> tuple[Float32, Float32]:
        if colors.shape[1] != 3 or early.weights.shape != (len(colors),):
            raise InputError(
                f"an early stop takes colors ({len(colors)}, 3) and as many weights, got {colors.shape} and "
                f"{early.weights.shape}"
            )
        weighted = np.concatenate([colors, early.weights[:, None]], axis=1).astype(np.float32)  # (N, 4)
        with borrow_workspace() as work:
            image, alpha, _ = blend_colors(self.geometry, weighted, np.append(behind, np.float32(0.0)), work, early.tau)
        return np.ascontiguousarray(image[..., :3]), alpha

    def backward_colors(self, cotangent: Float32) -> Float32:
        """(N, C) gradient of `render`'s image with respect to the colours, ``sum_p w_i(p) cotangent(p)``, for (H, W, C)
        dL/dimage.

        Linear in the cotangent, independent of the colours, and the same bits whatever the number of threads; 0 for
        Gaussians that are not seen. InputError if the shape is wrong.
        """
        geometry = self.geometry
        camera = geometry.camera
        cotangent = np.asarray(cotangent)
        shape = (camera.height, camera.width)
        if cotangent.ndim != 3 or cotangent.shape[:2] != shape or not 1 <= cotangent.shape[2] <= _WIDTHS[-1]:
            raise InputError(f"cotangent has shape {cotangent.shape}, expected {(*shape, f'1 to {_WIDTHS[-1]}')}")
        out = np.empty((geometry.count, cotangent.shape[2]), dtype=np.float32)
        width = width_of(cotangent.shape[2])
        pair = pair_width(width)
        with borrow_workspace() as work:
            sums = work.array("pairs", (len(geometry.ids) * pair,))
            bench = work.tile_bench(backward_scratch(width, pair))
            flat = widened(cotangent, width).reshape(-1)
            pair_sums(geometry.lists, (0,) * width, (0,) * pair, flat, sums, bench)
            gather_sums(sums, (0,) * pair, geometry.firsts, geometry.slots, thread_count(), out)
        return out

    def weights(self) -> tuple[Float32, Float32]:
        """Of the blending weights w = alpha T of every Gaussian, over the pixels: sum of w (pixels covered) and sum of
        w^2, (N,) each; 0 for Gaussians that are not seen."""
        geometry = self.geometry
        out = np.empty((geometry.count, WEIGHT_SUMS), dtype=np.float32)
        with borrow_workspace() as work:
            sums = work.array("pairs", (len(geometry.ids) * WEIGHT_SUMS,))
            bench = work.tile_bench(backward_scratch(0, WEIGHT_SUMS))
            pair_sums(geometry.lists, (), (0,) * WEIGHT_SUMS, None, sums, bench)
            gather_sums(sums, (0,) * WEIGHT_SUMS, geometry.firsts, geometry.slots, thread_count(), out)
        return out[:, 0].copy(), out[:, 1].copy()


def prepare_view(model: GaussianModel, camera: Camera, settings: RasterSettings = RasterSettings()) -> View:
    """Project, sort and bin a model once, for many images or gradients of its colours, which are not looked at.

    InputError if a shape is wrong or the image is too large.
    """
    with borrow_workspace() as work:
        geometry, _ = build_geometry(model, camera, settings, work, keep=True)
    return View(geometry)


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
