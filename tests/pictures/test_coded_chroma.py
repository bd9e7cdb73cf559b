"""What a JPEG coder stored of chroma is found again, and says more of a faint change than the plain residual."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from engine.model import Float32, Float64
from engine.pictures.alignment.residual import OPPONENT, image_cotangent
from engine.pictures.alignment.tone_and_light import Toned
from engine.pictures.jpeg.coded_blocks import tiles, transform
from engine.pictures.jpeg.coded_chroma import CodedChroma
from tests.pictures.image_cases import coarse_picture

SIDE = 320


def saved(image: Float32, quality: int, subsampling: int = 2) -> Float32:
    stream = io.BytesIO()
    eight = Image.fromarray(np.round(255.0 * image).astype(np.uint8))
    eight.save(stream, "jpeg", quality=quality, subsampling=subsampling)
    return np.asarray(Image.open(stream).convert("RGB"), dtype=np.float32) / 255.0


def colored(seed: int) -> Float32:
    """Color that varies from block to block and within."""
    rng = np.random.default_rng(seed)
    image = coarse_picture(seed, SIDE).copy()
    for sigma, size in ((12.0, 0.1), (2.0, 0.04)):
        tint = ndimage.gaussian_filter(rng.normal(size=(SIDE, SIDE, 2)), (sigma, sigma, 0))
        image += (size / tint.std() * tint) @ OPPONENT[1:]
    return np.clip(image, 0.05, 0.95).astype(np.float32)


def whole(image: Float32) -> np.ndarray:
    return np.ones(image.shape[:2], dtype=bool)


@pytest.mark.parametrize("quality", [50, 80])
def test_the_multiples_are_those_that_the_coder_stored(quality: int) -> None:
    image = np.round(255.0 * colored(1)).astype(np.float32) / np.float32(255.0)
    found = CodedChroma.of(saved(image, quality), whole(image), image, quality)
    assert found is not None
    assert found.first == (0, 0)
    for plane, stored in zip((1, 2), found.stored, strict=True):
        halves = (255.0 * image @ OPPONENT[plane]).reshape(SIDE // 2, 2, SIDE // 2, 2).mean(axis=(1, 3))
        coder = np.round(transform(np.ascontiguousarray(tiles(halves))) / found.steps) * found.steps
        assert (coder == stored)[found.whole[plane - 1]].mean() > 0.97  # integer transforms round some otherwise
    assert found.whole.mean() > 0.9


def test_blocks_begin_where_the_picture_was_cut() -> None:
    picture = saved(colored(1), 80)
    for top, left in ((8, 0), (16, 24)):
        found = CodedChroma.of(picture[top:, left:], whole(picture)[top:, left:], picture[top:, left:], 80)
        assert found is not None
        assert found.first == (top % 16 // 2, left % 16 // 2)


def test_what_no_coder_halved_has_none() -> None:
    image = colored(1)
    for other in (image, saved(image, 80, subsampling=0), ndimage.gaussian_filter(saved(image, 80), (0.7, 0.7, 0))):
        assert CodedChroma.of(other.astype(np.float32), whole(image), image, 80) is None
    small = saved(image, 80)[:24]
    assert CodedChroma.of(small, whole(small), small, 80) is None


def test_what_is_masked_says_nothing_and_brightness_neither() -> None:
    image = colored(1)
    picture = saved(image, 80)
    mask = whole(image)
    mask[160:, :] = False
    found = CodedChroma.of(picture, mask, image, 80)
    assert found is not None
    said = found.cotangent(image)
    assert not said[160:].any()
    assert said[:160].any()
    gray = np.ones(3, np.float32)  # its Cb and Cr are nothing
    np.testing.assert_allclose(said @ gray, 0.0, atol=1e-4 * np.abs(said).max())


def tinted(base: Float32, seed: int, count: int) -> Iterator[tuple[Float64, Float32, Float32]]:
    """Signs of a faint tint, the tint, and the coded picture that shows it beside another renderer's errors, which lie
    along edges."""
    rng = np.random.default_rng(seed)
    edges = np.abs(ndimage.gaussian_gradient_magnitude(base[..., 1], 1.0))[..., None]
    for _ in range(count):
        signs = rng.choice([-1.0, 1.0], (40, 40))
        pattern = (np.kron(signs, np.full((8, 8), 1.0 / 255.0))[..., None] * OPPONENT[1]).astype(np.float32)
        errors = ndimage.gaussian_filter(rng.normal(size=base.shape), (1.0, 1.0, 0.0)) * 0.3 * edges
        yield signs, pattern, saved(np.clip(base + pattern + errors.astype(np.float32), 0.0, 1.0), 80)


def z_of(image: Float32, signs: Float64) -> float:
    y = (image @ OPPONENT[1]).reshape(40, 8, 40, 8).sum(axis=(1, 3)) * signs
    return float(y.sum() / np.sqrt(np.square(y).sum()))


def test_the_score_finds_a_faint_tint_that_the_residual_loses() -> None:
    base = colored(2)
    residual, score = [], []
    for signs, pattern, picture in tinted(base, 2, 12):
        found = CodedChroma.of(picture, whole(base), pattern, 80)
        assert found is not None
        plain = image_cotangent(base, picture, whole(base), Toned(base, np.ones_like(base)), planes=slice(1, 3))
        residual.append(z_of(plain, signs))
        score.append(z_of(found.cotangent(base), signs))
    assert np.mean(score) > 1.1 * np.mean(residual) > 2.0


def test_what_lies_off_the_multiples_would_drown_the_rest() -> None:
    """A translucent panel over half of the picture, drawn after it was coded."""
    base = colored(2)
    kept, counted = [], []
    for signs, pattern, picture in tinted(base, 3, 4):
        picture[: SIDE // 2] = 0.5 * picture[: SIDE // 2] + np.float32([0.2, 0.25, 0.3])
        found = CodedChroma.of(picture, whole(base), pattern, 80)
        assert found is not None
        kept.append(z_of(found.cotangent(base), signs))
        every = replace(found, whole=np.ones_like(found.whole))
        counted.append(z_of(every.cotangent(base), signs))
    assert np.mean(kept) > 1.1 * np.mean(counted) > 5.0
