"""A picture of a bent model is laid over the reference part by part; one that fits stays as it is."""

from __future__ import annotations

import numpy as np
import pytest

from engine.model import Camera, Float32, Float64, GaussianModel
from engine.numerics.resampling import remap
from engine.pictures.alignment import local_flow as local_alignment
from engine.pictures.alignment.config import CONFIG
from engine.pictures.alignment.local_flow import align_locally
from engine.pictures.landmarks.keypoints import luma
from engine.raster import render_depth
from tests.pictures.plant_views import around, jpeg


@pytest.fixture(scope="module")
def camera(plant: GaussianModel) -> Camera:
    return around(plant, 100.0, 25.0, 1.5, 1.4)


@pytest.fixture(scope="module")
def view(plant: GaussianModel, camera: Camera) -> tuple[Float32, Float32]:
    image, alpha, _ = render_depth(plant, camera)
    return np.clip(image, 0.0, 1.0), alpha


def bent(shape: tuple[int, ...], most: float) -> tuple[Float64, Float64]:
    """Where the pixels of a picture come from, and what they are off by: nothing at its top, the most at its foot."""
    row, column = np.mgrid[: shape[0], : shape[1]].astype(np.float64) + 0.5
    off = most * np.square(row / shape[0])
    return np.stack([column - off, row], axis=2), np.stack([off, np.zeros_like(off)], axis=2)


def test_what_was_bent_by_many_pixels_is_found_to_a_fraction_of_one(view: tuple[Float32, Float32]) -> None:
    plain, alpha = view
    source, off = bent(plain.shape, 15.0)
    picture = jpeg(0.8 * remap(plain, source)[0] + 0.05, 80)
    found = align_locally(plain, alpha, picture)
    assert found is not None
    assert found.mask[alpha > 0.5].mean() > 0.7
    assert not found.mask[alpha < 0.1].any()
    missed = np.linalg.norm(found.flow - off, axis=2)[found.mask]
    assert np.median(missed) < 0.15
    assert np.quantile(missed, 0.9) < 0.6
    assert np.abs(luma(found.warped) - 0.8 * luma(plain) - 0.05)[found.mask].mean() < 0.02


def test_rough_flow_is_followed_to_the_end_in_a_small_picture(plant: GaussianModel, camera: Camera) -> None:
    """A tenth of it lies half a pixel off and more where flow at half size has the last word."""
    image, alpha, _ = render_depth(plant, camera.with_side(256))
    plain = np.clip(image, 0.0, 1.0)
    source, off = bent(plain.shape, 15.0)
    found = align_locally(plain, alpha, jpeg(0.8 * remap(plain, source)[0] + 0.05, 80))
    assert found is not None
    assert np.quantile(np.linalg.norm(found.flow - off, axis=2)[found.mask], 0.9) < 0.45


def test_what_fits_is_not_searched(view: tuple[Float32, Float32], monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Float32) -> None:
        raise AssertionError("searched")

    monkeypatch.setattr(local_alignment, "_dense", fail)
    plain, alpha = view
    assert align_locally(plain, alpha, jpeg(0.7 * plain + 0.1, 80)) is None
    assert align_locally(plain, np.zeros_like(alpha), plain) is None


def test_what_fits_nowhere_is_not_bent(plant: GaussianModel, view: tuple[Float32, Float32]) -> None:
    """Another view of it, and one blurred and noisy, which differs all over and lies right."""
    plain, alpha = view
    other, _, _ = render_depth(plant, around(plant, 280.0, 30.0, 1.5, 1.4))
    noisy = plain + np.random.default_rng(0).normal(0.0, 0.1, plain.shape).astype(np.float32)
    for picture in (other, noisy):
        assert align_locally(plain, alpha, jpeg(picture, 60)) is None


def test_what_was_painted_over_is_masked(view: tuple[Float32, Float32]) -> None:
    plain, alpha = view
    source, off = bent(plain.shape, 15.0)
    picture = remap(plain, source)[0]
    row, column = (int(np.median(each)) for each in np.nonzero(alpha > 0.9))
    picture[row - 20 : row + 20, column - 20 : column + 20] = (0.2, 0.5, 0.9)
    found = align_locally(plain, alpha, jpeg(picture, 80))
    assert found is not None
    there = round(column - off[row, column, 0])
    assert found.mask[row - 15 : row + 15, there - 15 : there + 15].mean() < 0.1


def test_what_differs_and_is_not_bent_is_given_up_at_half_size(
    plant: GaussianModel, camera: Camera, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Six rounds at full size cost a second of every such picture, which most viewers' pictures are."""

    def fail(*_: Float32) -> None:
        raise AssertionError("bent")

    image, alpha, _ = render_depth(plant, camera.with_side(2 * CONFIG.flow.telling))
    plain = np.clip(image, 0.0, 1.0)
    noisy = plain + np.random.default_rng(0).normal(0.0, 0.1, plain.shape).astype(np.float32)
    monkeypatch.setattr(local_alignment, "_step", fail)
    assert align_locally(plain, alpha, jpeg(noisy, 60)) is None
