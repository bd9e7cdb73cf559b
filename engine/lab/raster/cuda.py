"""The same image on a GPU: `gsplat`, an optional extra. Torch is imported only when something is drawn."""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING

from engine.errors import InputError
from engine.raster.settings import RasterSettings

if TYPE_CHECKING:
    import torch

__all__ = ["available", "rasterize"]


def available() -> bool:
    """Whether a CUDA device and the gsplat package are both there."""
    if importlib.util.find_spec("gsplat") is None:
        return False
    import torch

    return torch.cuda.is_available()


def rasterize(
    means: torch.Tensor,
    quats: torch.Tensor,
    log_scales: torch.Tensor,
    opacity_logits: torch.Tensor,
    viewmat: torch.Tensor,
    K: torch.Tensor,
    width: int,
    height: int,
    sh: torch.Tensor | None,
    colors: torch.Tensor | None,
    background: float | tuple[float, float, float],
    settings: RasterSettings,
) -> tuple[torch.Tensor, torch.Tensor]:
    """`engine.lab.raster.autograd.rasterize` on tensors of a CUDA device.

    InputError if gsplat is not installed, or a setting differs from what is fixed in its kernels (alpha_clamp,
    alpha_skip, transmittance_stop, by_distance).
    """
    if importlib.util.find_spec("gsplat") is None:
        raise InputError("tensors are on a CUDA device: pip install 'mark3dgs[cuda]', or move them to the CPU")
    fixed = RasterSettings(eps2d=settings.eps2d, near=settings.near, antialiased=settings.antialiased)
    if settings != fixed:
        raise InputError(f"gsplat's alpha limits, order and stop rule are fixed: expected {fixed}, got {settings}")
    import torch
    from gsplat import rasterization

    behind = torch.as_tensor(background, dtype=torch.float32, device=means.device).expand(3)
    degree = None if sh is None else {1: 0, 4: 1, 9: 2, 16: 3}[sh.shape[1]]
    shades = colors if sh is None else sh
    if shades is None:
        raise InputError("give either sh or colors")
    raw = (means.float(), quats.float(), log_scales.float().exp(), opacity_logits.float().sigmoid(), shades.float())
    image, alpha, _ = rasterization(
        *raw,
        viewmat.float()[None],
        K.float()[None],
        width,
        height,
        near_plane=settings.near,
        eps2d=settings.eps2d,
        sh_degree=degree,
        packed=False,
        backgrounds=behind[None],
        rasterize_mode="antialiased" if settings.antialiased else "classic",
    )
    return image[0], alpha[0, ..., 0]
