"""MS-SSIM against its definition written out with scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from engine.errors import InputError
from engine.lab.sim.multiscale_ssim import LEAST_SIDE, SCALE_WEIGHTS, ms_ssim_distance


def twin(a: np.ndarray, b: np.ndarray) -> float:
    """Wang et al. 2003, equation 7, one channel at a time in float64; a colour picture's maps are averaged together."""
    a, b = (np.clip(v.astype(np.float64), 0, 1) for v in (a, b))
    value = 1.0
    for scale, weight in enumerate(SCALE_WEIGHTS):
        contrast, light = [], []
        for x, y in zip(np.moveaxis(a, 2, 0), np.moveaxis(b, 2, 0), strict=True):
            mean = lambda v: gaussian_filter(v, 1.5, radius=5)[5:-5, 5:-5]  # noqa: E731
            mx, my = mean(x), mean(y)
            vx, vy, cov = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
            contrast.append((2 * cov + 0.03**2) / (vx + vy + 0.03**2))
            light.append((2 * mx * my + 0.01**2) / (mx * mx + my * my + 0.01**2))
        shared = np.array(contrast) * (np.array(light) if scale == 4 else 1.0)
        value *= max(shared.mean(), 0.0) ** weight
        h, w = a.shape[0] // 2 * 2, a.shape[1] // 2 * 2
        a, b = (v[:h, :w].reshape(h // 2, 2, w // 2, 2, 3).mean(axis=(1, 3)) for v in (a, b))
    return 1.0 - value


def picture(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:181, :203]
    waves = np.stack([np.sin(x / (4 + c) + seed) * np.cos(y / (9 - c)) for c in range(3)], axis=-1)
    return np.clip(0.5 + 0.3 * waves + 0.05 * rng.standard_normal(waves.shape), 0, 1).astype(np.float32)


@pytest.mark.parametrize("std", [0.0, 0.01, 0.1, 0.4])
def test_agrees_with_the_definition(std: float) -> None:
    a = picture(0)
    b = (a + std * np.random.default_rng(1).standard_normal(a.shape)).astype(np.float32)
    assert ms_ssim_distance(a, b) == pytest.approx(twin(a, b), abs=1e-5)
    assert (ms_ssim_distance(a, b) > 1e-4) == (std > 0)


def test_inverted_structure_is_as_far_as_it_goes() -> None:
    assert ms_ssim_distance(picture(0), 1 - picture(0)) == 1.0


def test_coarse_damage_counts_more_than_fine() -> None:
    """Equal error power, once in single pixels and once in 16 x 16 blocks."""
    a, rng = picture(0), np.random.default_rng(2)
    fine = rng.standard_normal((181, 203, 1))
    coarse = np.kron(rng.standard_normal((12, 13)), np.ones((16, 16)))[:181, :203, None]
    near, far = (np.clip(a + 0.08 * e / e.std(), 0, 1).astype(np.float32) for e in (fine, coarse))
    assert ms_ssim_distance(a, far) > ms_ssim_distance(a, near)


def test_small_pictures_are_refused() -> None:
    small = np.zeros((LEAST_SIDE - 1, 300, 3), np.float32)
    with pytest.raises(InputError, match="176"):
        ms_ssim_distance(small, small)
