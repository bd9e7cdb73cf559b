from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate, ndimage
from scipy.stats import norm

from engine.model import GaussianModel
from engine.pictures.jpeg.coded_blocks import (
    LUMA,
    _truncated_mean,
    agreement,
    block_spread,
    find_quality,
    jpeg_cotangent,
    match_exposure,
)
from engine.raster import render
from tests.pictures.image_cases import coarse_picture as picture
from tests.pictures.image_cases import saved as save
from tests.pictures.plant_views import around, jpeg


def test_truncated_mean_against_the_integral() -> None:
    for low, high in [(-1.0, 2.0), (0.5, 0.7), (-9.0, -7.0), (6.0, 30.0), (-40.0, 40.0)]:
        mass = norm.cdf(high) - norm.cdf(low) if low < 5 else norm.sf(low) - norm.sf(high)
        value, _ = integrate.quad(lambda t: t * norm.pdf(t), max(low, -12), min(high, 12))
        got = float(_truncated_mean(np.array([low]), np.array([high]))[0])
        assert got == pytest.approx(value / mass, rel=1e-3, abs=1e-6)
        assert low <= got <= high


def test_the_score_finds_a_faint_pattern_that_the_residual_loses() -> None:
    """Pattern of less than half a grey level under quality 10: matched filter on the residual against the score."""
    rng = np.random.default_rng(1)
    base = picture(2, 320)
    residual, score = [], []
    for _ in range(12):
        coarse = rng.choice([-1.0, 1.0], (40, 40)) * 0.4 / 255.0
        pattern = np.kron(coarse, np.ones((8, 8)))[:, :, None].astype(np.float32) * np.ones(3, np.float32)
        suspect = save(np.clip(base + pattern, 0, 1), 10)
        quality = find_quality(suspect)
        assert quality is not None
        mask = np.ones(base.shape[:2], bool)
        cotangent = jpeg_cotangent(base, suspect, mask, block_spread(pattern), quality)
        for cells, image in ((residual, suspect - base), (score, cotangent)):
            y = (image @ LUMA).reshape(40, 8, 40, 8).sum(axis=(1, 3)) * np.sign(coarse)
            cells.append(y.sum() / np.sqrt((y**2).sum()))
    assert np.mean(score) > 1.15 * np.mean(residual)


def test_a_mark_is_weighed_by_how_loud_it_is_nearby() -> None:
    """Loud in a corner and a fifth of that elsewhere: one strength for all of the picture reads less."""
    rng = np.random.default_rng(1)
    base = picture(2, 320)
    loud = np.full((40, 40), 0.2)
    loud[:14, :14] = 1.0
    local, alike = [], []
    for _ in range(12):
        coarse = rng.choice([-1.0, 1.0], (40, 40)) * loud * 2.0 / 255.0
        pattern = np.kron(coarse, np.ones((8, 8)))[:, :, None].astype(np.float32) * np.ones(3, np.float32)
        suspect = save(np.clip(base + pattern, 0, 1), 20)
        spread = block_spread(pattern)
        assert spread.shape == (40, 40, 8, 8)
        everywhere = np.sqrt(np.square(spread).mean(axis=(0, 1)))
        for read, used in ((local, spread), (alike, everywhere)):
            image = jpeg_cotangent(base, suspect, np.ones(base.shape[:2], bool), used, 20)
            y = (image @ LUMA).reshape(40, 8, 40, 8).sum(axis=(1, 3)) * coarse
            read.append(y.sum() / np.sqrt((y**2).sum()))
    assert np.mean(local) > 1.2 * np.mean(alike)


def test_unmarked_pictures_score_nothing() -> None:
    base = picture(3, 240)
    suspect = save(base, 30)
    quality = find_quality(suspect)
    assert quality is not None
    spread = np.full((8, 8), 1.0)
    image = jpeg_cotangent(base, suspect, np.ones((240, 240), bool), spread, quality)
    cells = (image @ LUMA).reshape(30, 8, 30, 8).sum(axis=(1, 3)).reshape(-1)
    for seed in range(200):
        signs = np.random.default_rng(seed).choice([-1.0, 1.0], len(cells))
        assert abs(float(signs @ cells)) / np.sqrt(float(cells @ cells)) < 5.0


def test_masked_blocks_are_left_out() -> None:
    base = picture(4)
    suspect = save(base, 30)
    mask = np.ones((160, 160), bool)
    mask[:80] = False
    cotangent = jpeg_cotangent(base, suspect, mask, np.ones((8, 8)), 30)
    assert not cotangent[:80].any()
    assert cotangent[80:].any()
    whole = jpeg_cotangent(base, suspect, np.ones_like(mask), np.ones((8, 8)), 30)
    np.testing.assert_array_equal(cotangent[80:], whole[80:])  # and say nothing about the others


def test_agreement_falls_with_a_tenth_of_a_pixel() -> None:
    base = picture(6, 240)
    suspect = save(base, 20)
    everywhere = np.ones(base.shape[:2], bool)
    shifted = [ndimage.shift(base, (0, d, 0), order=3, mode="nearest") for d in (0.0, 0.1, 0.3)]
    found = [agreement(known.astype(np.float32), suspect, everywhere, 20) for known in shifted]
    assert found[0] > 0.97
    assert found[0] > found[1] + 0.01 > found[2] + 0.03
    assert agreement(base, suspect, ~everywhere, 20) == 0.0


def test_chroma_that_a_coarse_coder_emptied_is_no_exposure(plant: GaussianModel) -> None:
    """JPEG quality 10 changes a channel's gain by up to 3 % and its offset by 0.02; a real tint is still corrected."""
    image = np.clip(render(plant, around(plant, 40.0, 20.0, 2.0, 1.1)), 0.0, 1.0)
    seen = np.ones(image.shape[:2], dtype=bool)
    np.testing.assert_array_equal(match_exposure(image, jpeg(image, 10), seen, 10), image)
    tinted = image * np.float32([1.0, 0.9, 0.8])
    off = np.abs(match_exposure(image, jpeg(tinted, 30), seen, 30) - tinted).mean()
    assert off < 0.3 * np.abs(image - tinted).mean()
