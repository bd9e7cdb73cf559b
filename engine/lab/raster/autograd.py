"""The rasterizer as one torch operation. The only file of the CPU path that imports torch."""

from typing import Any

import numpy as np
import torch

from engine.errors import InputError
from engine.model import Camera, GaussianModel
from engine.raster import cuda
from engine.raster.gradients import Rendering, backward, draw
from engine.raster.settings import RasterSettings

__all__ = ["rasterize"]


def rasterize(
    means: torch.Tensor,
    quats: torch.Tensor,
    log_scales: torch.Tensor,
    opacity_logits: torch.Tensor,
    viewmat: torch.Tensor,
    K: torch.Tensor,
    width: int,
    height: int,
    *,
    sh: torch.Tensor | None = None,
    colors: torch.Tensor | None = None,
    background: float | tuple[float, float, float] = 0.0,
    settings: RasterSettings = RasterSettings(),
) -> tuple[torch.Tensor, torch.Tensor]:
    """Image (H, W, 3) and accumulated opacity (H, W), float32, differentiable with respect to every tensor.

    Tensors on the CPU go through this package's kernels, without copies where they are contiguous float32. Tensors on a
    CUDA device go through `gsplat` if that is installed, with the same definition of the image.

    Gaussians are as in `GaussianModel`, with quaternions of any length but 0; `sh` (N, 1, 4, 9 or 16, 3) are
    spherical-harmonic colours, `colors` (N, 3) colours as they are: one of them. `viewmat` (4, 4) is world to camera;
    its gradient takes twelve numbers as free, and the camera's centre is -R^T t. Of `K` (3, 3), in pixels, fx, fy, cx
    and cy have gradients.

    InputError if not exactly one of `sh` and `colors` is given, a shape is wrong, or tensors are on a CUDA device and
    gsplat is missing or cannot honour the settings.
    """
    if (sh is None) == (colors is None):
        raise InputError("give either sh or colors")
    if means.is_cuda:
        model = (means, quats, log_scales, opacity_logits)
        return cuda.rasterize(*model, viewmat, K, width, height, sh, colors, background, settings)
    image, alpha = _Rasterize.apply(  # type: ignore[no-untyped-call]  # torch leaves it untyped
        means, quats, log_scales, opacity_logits, viewmat, K, sh, colors, (width, height, background, settings)
    )
    return image, alpha


def _array(tensor: torch.Tensor) -> Any:
    return tensor.detach().numpy()


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        means: torch.Tensor,
        quats: torch.Tensor,
        log_scales: torch.Tensor,
        opacity_logits: torch.Tensor,
        viewmat: torch.Tensor,
        K: torch.Tensor,
        sh: torch.Tensor | None,
        colors: torch.Tensor | None,
        options: tuple[int, int, float | tuple[float, float, float], RasterSettings],
    ) -> tuple[torch.Tensor, torch.Tensor]:
        width, height, background, settings = options
        coefficients = np.zeros((len(means), 1, 3), np.float32) if sh is None else _array(sh)
        model = GaussianModel(_array(means), _array(log_scales), _array(quats), _array(opacity_logits), coefficients)
        camera = Camera(_array(viewmat), _array(K), width, height)
        given = None if colors is None else _array(colors)
        ctx.rendering = draw(model, camera, background, settings, colors=given)
        ctx.inputs = (means, quats, log_scales, opacity_logits, viewmat, K, sh, colors)
        ctx.set_materialize_grads(False)
        # The rendering keeps its own arrays: a caller may write into the tensors.
        image, alpha = ctx.rendering.image.copy(), ctx.rendering.alpha.copy()
        return torch.from_numpy(image), torch.from_numpy(alpha)

    @staticmethod
    def backward(ctx: Any, *cotangents: torch.Tensor | None) -> tuple[torch.Tensor | None, ...]:
        rendering: Rendering = ctx.rendering
        of_image, of_alpha = (None if c is None else c.detach().numpy() for c in cotangents)
        if of_image is None:
            of_image = np.zeros_like(rendering.image)
        g = backward(rendering, of_image, of_alpha)
        colors = (None, g.colors) if rendering.own_colors else (g.sh, None)
        arrays = (g.means, g.quats, g.log_scales, g.opacity_logits, g.viewmat, g.K, *colors)
        results = [
            torch.from_numpy(array).to(tensor.dtype) if tensor is not None and needed else None
            for array, tensor, needed in zip(arrays, ctx.inputs, ctx.needs_input_grad, strict=False)
        ]
        return (*results, None)
