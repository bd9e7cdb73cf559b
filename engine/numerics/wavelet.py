"""Orthonormal multi-level Haar transform of images; the same code runs on numpy arrays and torch tensors.

An odd last row or column is its own partner: its detail is zero and left out, so a constant image has no
details at any level, the inverse is exact for every size, and energy is preserved where the sizes are even.
"""

from typing import Any, TypeAlias

import numpy as np

from engine.model import Float32

ArrayLike2d: TypeAlias = Any
"""(H, W) or (H, W, C), numpy array or torch tensor of a floating type."""

Details: TypeAlias = list[tuple[ArrayLike2d, ArrayLike2d, ArrayLike2d]]
"""Per level, finest first: (LH, HL, HH). The first letter is the filter along x, the second along y."""

_SQRT_HALF = 0.5**0.5


def _join(parts: list[ArrayLike2d], axis: int) -> ArrayLike2d:
    if isinstance(parts[0], np.ndarray):
        return np.concatenate(parts, axis=axis)
    import torch  # only reached with tensors: numpy users never pay for the import

    return torch.cat(parts, dim=axis)


def _analyze(x: ArrayLike2d, axis: int) -> tuple[ArrayLike2d, ArrayLike2d]:
    """Low-pass (ceil(n/2)) and high-pass (floor(n/2)) halves along an axis."""
    n = x.shape[axis]
    at = (slice(None),) * axis
    even, odd = x[(*at, slice(0, n - n % 2, 2))], x[(*at, slice(1, None, 2))]
    low, high = (even + odd) * _SQRT_HALF, (even - odd) * _SQRT_HALF
    if n % 2:
        low = _join([low, x[(*at, slice(n - 1, n))] / _SQRT_HALF], axis)
    return low, high


def _synthesize(low: ArrayLike2d, high: ArrayLike2d, axis: int) -> ArrayLike2d:
    k = high.shape[axis]
    at = (slice(None),) * axis
    paired = low[(*at, slice(0, k))]
    even, odd = (paired + high) * _SQRT_HALF, (paired - high) * _SQRT_HALF
    fresh = (*at, slice(None), None)  # interleave: a new axis after `axis`, then fold it in
    shape = (*paired.shape[:axis], 2 * k, *paired.shape[axis + 1 :])
    x = _join([even[fresh], odd[fresh]], axis + 1).reshape(shape)
    return x if low.shape[axis] == k else _join([x, low[(*at, slice(k, None))] * _SQRT_HALF], axis)


def dwt2(image: ArrayLike2d, levels: int) -> tuple[ArrayLike2d, Details]:
    """Haar transform of an image (H, W) or (H, W, C) of any size, odd ones included (differentiable when given a
    tensor).

    Returns the low-pass band (ceil(H / 2^levels), ceil(W / 2^levels)[, C]), in which a constant image c gives c *
    2^levels; and (LH, HL, HH) of each level, finest first. From a level's input of h x w: LH (low along x, high along
    y: horizontal edges) is floor(h/2) x ceil(w/2), HL ceil(h/2) x floor(w/2), HH floor(h/2) x floor(w/2).
    """
    details: Details = []
    approx = image
    for _ in range(levels):
        low_y, high_y = _analyze(approx, 0)
        approx, hl = _analyze(low_y, 1)
        lh, hh = _analyze(high_y, 1)
        details.append((lh, hl, hh))
    return approx, details


def coefficient_detail(colors: ArrayLike2d) -> ArrayLike2d:
    """(n, K // 2, 3) detail of colours (n, K, 3): one Haar step over the coefficients of each channel (Eq 7)."""
    even = colors.shape[1] // 2 * 2
    return (colors[:, 0:even:2] - colors[:, 1:even:2]) * _SQRT_HALF


def idwt2(approx: ArrayLike2d, details: Details) -> ArrayLike2d:
    """Inverse of `dwt2`, possibly of changed coefficients: exact for every size."""
    for lh, hl, hh in reversed(details):
        approx = _synthesize(_synthesize(approx, hl, 1), _synthesize(lh, hh, 1), 0)
    return approx


def high_frequency_energy(image: ArrayLike2d, levels: int = 2) -> Float32:
    """(H, W) squared detail coefficients, spread over the pixels they belong to (||DWT(I_p)||^2 of Eq 4), mean over
    channels.

    Two levels see structures of up to four pixels. Squared image units: with H and W multiples of 2^levels the sum is
    the energy of the image less that of the low-pass band.
    """
    height, width = image.shape[:2]
    pixels = np.asarray(image, dtype=np.float32).reshape(height, width, -1)  # (H, W, C)
    energy = np.zeros((height, width), dtype=np.float32)
    for level, bands in enumerate(dwt2(pixels, levels)[1], start=1):
        block = 2**level
        total = np.zeros((-(-height // block), -(-width // block)), dtype=np.float32)
        for band in bands:
            h, w = band.shape[:2]
            total[:h, :w] += np.mean(np.square(band), axis=2)
        spread = np.repeat(np.repeat(total / block**2, block, axis=0), block, axis=1)
        energy += spread[:height, :width]
    return energy
