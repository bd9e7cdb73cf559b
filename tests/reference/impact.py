"""Eq 4 and the Laplace curvature, defined the slow way: from every Gaussian's blending weight at every pixel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.model import Camera, GaussianModel
from tests.reference.raster import parameters, rasterize
from tests.reference.spherical_harmonics import sh_value


def blending_weights(model: GaussianModel, camera: Camera) -> np.ndarray:
    """(N, H, W) w = alpha T."""
    return rasterize(parameters(model, camera), camera.width, camera.height)[2].numpy()


def detail(image: np.ndarray) -> np.ndarray:
    """(H, W) ||DWT(p)||: root of the Haar energy of two levels, H and W multiples of 4, mean over the channels.

    What an orthonormal Haar level takes out of a block of 2 x 2 is its energy less that of its sum over 2.
    """
    energy = np.zeros(image.shape)
    sums = image.astype(np.float64)
    for side in (2, 4):
        h, w, channels = sums.shape
        blocks = sums.reshape(h // 2, 2, w // 2, 2, channels)
        low = blocks.sum(axis=(1, 3)) / 2
        high = (blocks**2).sum(axis=(1, 3)) - low**2
        energy += np.kron(high / side**2, np.ones((side, side, 1)))
        sums = low
    return np.sqrt(energy.mean(axis=2))


def coherence(means: np.ndarray) -> np.ndarray:
    """(N,) exp(-|mu_i - mu_nn|^2 / 2 sigma^2), sigma twice the median distance to the nearest neighbour."""
    gaps = np.linalg.norm(means[:, None] - means[None], axis=2) + np.diag(np.full(len(means), np.inf))
    nearest = gaps.min(axis=1)
    return np.exp(-(nearest**2) / (2 * (2 * np.median(nearest)) ** 2))


def impact(model: GaussianModel, cameras: Sequence[Camera], images: Sequence[np.ndarray]) -> np.ndarray:
    """(N,) Eq 4: sum over views and pixels of alpha T ||DWT(p)||, times the coherence."""
    seen = sum(
        np.einsum("nhw,hw->n", blending_weights(model, camera), detail(np.clip(image, 0, 1)))
        for camera, image in zip(cameras, images, strict=True)
    )
    return seen * coherence(model.means.astype(np.float64))


def curvature(model: GaussianModel, cameras: Sequence[Camera]) -> np.ndarray:
    """(N, K) sum over views and pixels of w_i(p)^2 Y_lm(d_i)^2."""
    total = np.zeros(model.sh.shape[:2])
    orders = [(l, m) for l in range(model.sh_degree + 1) for m in range(-l, l + 1)]
    for camera in cameras:
        squared = (blending_weights(model, camera) ** 2).sum(axis=(1, 2))
        for i, mean in enumerate(model.means.astype(np.float64)):
            direction = (mean - camera.position) / np.linalg.norm(mean - camera.position)
            total[i] += squared[i] * np.array([sh_value(l, m, direction) ** 2 for l, m in orders])
    return total
