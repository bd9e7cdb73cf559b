"""Random differentiable distortion layers for the refinement (paper: "JPEG and other common attacks").

Each layer maps an image (1, 3, H, W) in 0..1 to an image of the same size; where the real attack moves pixels
(rotation, rescaling, crop) the layer returns the picture as the aligned decoder will see it: moved and moved back,
with the lost detail lost and the lost pixels grey.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from engine.model import Float32
from engine.pictures.alignment.residual import OPPONENT
from engine.pictures.jpeg.coded_blocks import STANDARD_LUMA_TABLE
from engine.pictures.jpeg.coded_chroma import STANDARD_CHROMA_TABLE

JPEG_LUMA = STANDARD_LUMA_TABLE.astype(np.float32)
JPEG_CHROMA = STANDARD_CHROMA_TABLE.astype(np.float32)

_TO_YCC = torch.tensor(OPPONENT)


@lru_cache(maxsize=1)
def _dct() -> Tensor:
    k, n = np.arange(8)[:, None], np.arange(8)[None]
    basis = np.cos(np.pi * (2 * n + 1) * k / 16) * np.where(k == 0, np.sqrt(1 / 8), 0.5)
    return torch.tensor(basis, dtype=torch.float32)


def soft_round(x: Tensor) -> Tensor:
    """Rounds forward; its slope is 3 (x - round x)^2, so a gradient knows where a coefficient is about to flip."""
    whole = torch.round(x.detach())
    return whole + (x - whole) ** 3


def jpeg(image: Tensor, quality: float) -> Tensor:
    """JPEG with 4:2:0 chroma, quantisation soft-rounded (Shin & Song's cubic)."""
    factor = 50.0 / quality if quality < 50 else 2.0 - quality / 50.0
    height, width = image.shape[2:]
    padded = functional.pad(image, (0, -width % 16, 0, -height % 16), mode="replicate")
    ycc = torch.einsum("ij,bjhw->bihw", _TO_YCC, padded * 255.0)
    luma = _code_plane(ycc[:, :1] - 128.0, JPEG_LUMA, factor) + 128.0
    chroma = functional.avg_pool2d(ycc[:, 1:], 2)
    chroma = _code_plane(chroma.reshape(2, 1, *chroma.shape[2:]), JPEG_CHROMA, factor)
    chroma = functional.interpolate(chroma.reshape(1, 2, *chroma.shape[2:]), scale_factor=2, mode="nearest")
    rgb = torch.einsum("ij,bjhw->bihw", torch.linalg.inv(_TO_YCC), torch.cat([luma, chroma], 1)) / 255.0
    return rgb[:, :, :height, :width]


def _code_plane(plane: Tensor, table: Float32, factor: float) -> Tensor:
    steps = torch.tensor(np.clip(np.floor(table * factor + 0.5), 1, 255))
    count, _, height, width = plane.shape
    blocks = plane.reshape(count, height // 8, 8, width // 8, 8).permute(0, 1, 3, 2, 4)  # (c, by, bx, 8, 8)
    basis = _dct()
    coded = soft_round((basis @ blocks @ basis.T) / steps) * steps
    back = (basis.T @ coded @ basis).permute(0, 1, 3, 2, 4)
    return back.reshape(count, 1, height, width)


def blur(image: Tensor, sigma: float) -> Tensor:
    """Gaussian blur, reflected borders."""
    radius = max(1, int(3 * sigma + 0.5))
    taps = torch.exp(-0.5 * (torch.arange(-radius, radius + 1) / sigma) ** 2)
    taps = (taps / taps.sum()).to(image.dtype)
    rows = functional.conv2d(
        functional.pad(image, (radius,) * 2 + (0, 0), mode="reflect"),
        taps.view(1, 1, 1, -1).repeat(3, 1, 1, 1),
        groups=3,
    )
    return functional.conv2d(
        functional.pad(rows, (0, 0) + (radius,) * 2, mode="reflect"),
        taps.view(1, 1, -1, 1).repeat(3, 1, 1, 1),
        groups=3,
    )


def noise(image: Tensor, std: float, rng: np.random.Generator) -> Tensor:
    """Additive Gaussian noise, clipped as a stored picture is."""
    sample = torch.from_numpy(rng.standard_normal(tuple(image.shape), dtype=np.float32))
    return (image + std * sample).clamp(0.0, 1.0)


def rescale(image: Tensor, factor: float) -> Tensor:
    """Shrink and grow back."""
    size = image.shape[2:]
    small = [max(8, int(s * factor)) for s in size]
    return functional.interpolate(
        functional.interpolate(image, small, mode="bilinear", antialias=True), size, mode="bicubic"
    )


def rotate(image: Tensor, degrees: float) -> Tensor:
    """Rotate and rotate back: two interpolations and the corners gone."""
    for angle in (np.radians(degrees), -np.radians(degrees)):
        c, s = np.cos(angle), np.sin(angle)
        ratio = image.shape[2] / image.shape[3]
        theta = torch.tensor([[[c, -s * ratio, 0.0], [s / ratio, c, 0.0]]], dtype=torch.float32)
        grid = functional.affine_grid(theta, list(image.shape), align_corners=False)
        image = functional.grid_sample(image, grid, mode="bilinear", align_corners=False)
    return image


def crop(image: Tensor, keep: float, rng: np.random.Generator) -> Tensor:
    """Keep a rectangle holding a share `keep` of the area; the rest carries nothing."""
    height, width = image.shape[2:]
    h, w = int(height * np.sqrt(keep)), int(width * np.sqrt(keep))
    top, left = int(rng.integers(height - h + 1)), int(rng.integers(width - w + 1))
    mask = torch.zeros_like(image)
    mask[:, :, top : top + h, left : left + w] = 1.0
    return image * mask


def draw(rng: np.random.Generator) -> Callable[[Tensor], Tensor]:
    """One random layer with a random strength; the identity one time in seven.

    The returned function is a pure function of the image: applied to the marked and to the unmarked render it
    uses the same noise and the same crop, as an attack on one picture would.
    """
    kind, seed, u = int(rng.integers(7)), int(rng.integers(2**31)), float(rng.random())
    layers: list[Callable[[Tensor, np.random.Generator], Tensor]] = [
        lambda x, r: x,
        lambda x, r: jpeg(x, 10.0 + 60.0 * u),
        lambda x, r: blur(x, 0.5 + u),
        lambda x, r: noise(x, 0.02 + 0.08 * u, r),
        lambda x, r: crop(x, 0.4 + 0.4 * u, r),
        lambda x, r: rescale(x, 0.5 + 0.5 * u),
        lambda x, r: rotate(x, 60.0 * (u - 0.5)),
    ]
    return lambda image: layers[kind](image, np.random.default_rng(seed))
