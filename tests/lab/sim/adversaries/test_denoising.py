"""Denoisers of pictures take noise off and leave edges where they were."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.sim.attacks import image_attack
from engine.model import Float32
from engine.numerics.image_metrics import psnr

STRENGTHS = {"median": 5, "bilateral": 0.3, "denoise_nonlocal": 12, "denoise_wavelet": 0.15}


@pytest.fixture(scope="module")
def blocks() -> Float32:
    clean = np.full((96, 96, 3), 0.3, np.float32)
    clean[20:60, 30:80] = [0.7, 0.5, 0.4]
    return clean


@pytest.mark.parametrize("name", STRENGTHS)
def test_noise_goes_and_edges_stay(name: str, blocks: Float32) -> None:
    noisy = image_attack("noise_image").apply(blocks, 0.06, rng=1)
    out = image_attack(name).apply(noisy, STRENGTHS[name])
    assert psnr(blocks, out) > psnr(blocks, noisy) + 4
    assert out[40, 32].mean() - out[40, 27].mean() > 0.6 * (blocks[40, 32].mean() - blocks[40, 27].mean())


@pytest.mark.parametrize("name", STRENGTHS)
def test_stronger_is_further_from_the_picture(name: str, image: Float32) -> None:
    attack = image_attack(name)
    looks = [psnr(image, attack.apply(image, s)) for s in attack.grid]
    assert looks[0] > looks[-1] + 2


def test_wavelet_shrinkage_of_nothing_is_the_picture(image: Float32) -> None:
    np.testing.assert_allclose(image_attack("denoise_wavelet").apply(image, 0.0), image, atol=1e-6)
    with pytest.raises(InputError, match="odd"):
        image_attack("median").apply(image, 4)
