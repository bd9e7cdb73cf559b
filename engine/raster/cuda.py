"""The same image on a GPU: `gsplat`, an optional extra. Torch is imported only when something is drawn.

Measured with gsplat 1.5.3 on an H200: pictures of plain Gaussians agree with the CPU rasterizer's to 102 to 116 dB, and
so do their gradients (`tests/raster/test_cuda.py`). `draws_alike` leaves out what does not agree, or was not compared:
discs (gsplat would draw Gaussians that `eps2d` widens, not rays that meet a disc with a low pass of its
own); antialiased models (the same formula, but neither rasterizer was held against the other); lenses with skew, which
gsplat does not read from K. Spherical harmonics of any degree are evaluated here, not there.

Gradients are summed in the order in which threads arrive: the last bits differ from run to run, so a fit never comes
out twice the same.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.extras import load_extra
from engine.model import Camera, Float32, GaussianModel
from engine.raster.gradients import Gradients
from engine.raster.settings import RasterSettings

if TYPE_CHECKING:
    import torch

__all__ = ["DEVICES", "CudaView", "draws_alike", "find_device", "missing", "rasterize"]

DEVICES = ("auto", "cpu", "cuda")
"""What a user may ask for; `auto` is the GPU where there is one."""
_DEVICE = "cuda"
_GEOMETRY = ("means", "quats", "log_scales", "opacity_logits")


def find_device(wanted: str) -> str:
    """`cpu` or `cuda` for one of DEVICES; InputError where `cuda` is wanted and cannot be used, and why."""
    if wanted not in DEVICES:
        raise InputError(f"device must be one of {', '.join(DEVICES)}, got {wanted!r}")
    fault = None if wanted == "cpu" else missing()
    if wanted == "cuda" and fault is not None:
        raise InputError(fault)
    return "cpu" if wanted == "cpu" or fault is not None else "cuda"


def missing() -> str | None:
    """Why nothing can be drawn on a GPU here, None where it can: one Gaussian is drawn."""
    try:
        with redirect_stdout(sys.stderr):  # gsplat tells there that it compiles its kernels, which takes minutes, once
            torch, _ = (load_extra(name, "cuda", "device 'cuda'") for name in ("torch", "gsplat"))
            if not torch.cuda.is_available():
                return "device 'cuda' needs an NVIDIA GPU, and torch finds none: choose 'cpu', or 'auto'"
            zeros, turn = np.zeros((1, 3), dtype=np.float32), np.eye(1, 4, dtype=np.float32)
            model = GaussianModel(zeros + np.float32(2.0), zeros, turn, zeros[:, 0], zeros[:, None])
            CudaView(model, Camera(np.eye(4), np.eye(3), 16, 16)).render(zeros)
    except InputError as error:
        return str(error)
    except Exception as error:  # of torch, a driver, or a compiler that gsplat calls
        return f"device 'cuda': gsplat cannot draw here, {type(error).__name__}: {error}; choose 'cpu', or 'auto'"
    return None


def draws_alike(model: GaussianModel, cameras: Sequence[Camera] = ()) -> bool:
    """Whether gsplat draws the CPU rasterizer's picture of this model, seen by such cameras."""
    return not (model.is_flat or model.antialiased or any(camera.K[0, 1] != 0.0 for camera in cameras))


class CudaView:
    """One model from one camera on the GPU, in place of `engine.raster.View`; arrays in and out are of numpy."""

    def __init__(self, model: GaussianModel, camera: Camera) -> None:
        self._camera = camera
        self._geometry = [_tensor(getattr(model, name)) for name in _GEOMETRY]

    def render(self, colors: Float32) -> tuple[Float32, Float32]:
        """Image (H, W, 3) of colours (N, 3), and accumulated opacity (H, W)."""
        image, alpha = self._draw(_tensor(colors))
        return image.cpu().numpy(), alpha.cpu().numpy()

    def backward_colors(self, cotangent: Float32) -> Float32:
        """(N, 3) gradient of the image by the colours, for (H, W, 3) dL/dimage."""
        import torch

        with torch.enable_grad():  # a refinement calls from inside an operation of torch
            colors = torch.zeros_like(self._geometry[0], requires_grad=True)
            (found,) = torch.autograd.grad(self._draw(colors)[0], colors, _tensor(cotangent))
        return np.asarray(found.cpu().numpy())

    def gradients(self, colors: Float32, cotangent: Callable[[Float32], Float32], out: Gradients) -> None:
        """Write those by means, quats, log_scales and opacity_logits to `out`; `cotangent` gives dL/dimage (H, W, 3)
        of an image. Colours (N, 3) stand still; nothing else of `out` is written."""
        import torch

        leaves = [tensor.requires_grad_() for tensor in self._geometry]
        image, _ = self._draw(_tensor(colors))
        found = torch.autograd.grad(image, leaves, _tensor(cotangent(image.detach().cpu().numpy())))
        for name, gradient in zip(_GEOMETRY, found, strict=True):
            getattr(out, name)[:] = gradient.cpu().numpy()

    def _draw(self, colors: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        means, quats, log_scales, opacity_logits = self._geometry
        viewmat, K = _tensor(self._camera.viewmat), _tensor(self._camera.K)
        model, lens = (means, quats, log_scales, opacity_logits), (viewmat, K)
        return rasterize(*model, *lens, self._camera.width, self._camera.height, None, colors, 0.0, RasterSettings())


def _tensor(array: npt.ArrayLike) -> torch.Tensor:
    import torch

    return torch.tensor(array, dtype=torch.float32, device=_DEVICE)


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
    fixed = RasterSettings(eps2d=settings.eps2d, near=settings.near, antialiased=settings.antialiased)
    if settings != fixed:
        raise InputError(f"gsplat's alpha limits, order and stop rule are fixed: expected {fixed}, got {settings}")
    gsplat = load_extra("gsplat", "cuda", "drawing tensors of a CUDA device")
    import torch

    behind = torch.as_tensor(background, dtype=torch.float32, device=means.device).expand(3)
    degree = None if sh is None else {1: 0, 4: 1, 9: 2, 16: 3}[sh.shape[1]]
    shades = colors if sh is None else sh
    if shades is None:
        raise InputError("give either sh or colors")
    raw = (means.float(), quats.float(), log_scales.float().exp(), opacity_logits.float().sigmoid(), shades.float())
    image, alpha, _ = gsplat.rasterization(
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
