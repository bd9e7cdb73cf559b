from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from engine.pictures.jpeg.coded_blocks import (
    LUMA,
    JpegGrid,
    _fit_tables,
    blocks_of,
    find_grid,
    find_quality,
    luma_table,
)
from tests.pictures.image_cases import coarse_picture as picture
from tests.pictures.image_cases import saved as save
from tests.reference.jpeg_tables import fit_tables


def test_tables_are_those_that_pillow_writes() -> None:
    for quality in (10, 50, 75, 90):
        buffer = io.BytesIO()
        Image.new("RGB", (16, 16)).save(buffer, "JPEG", quality=quality)
        written = sorted(Image.open(buffer).quantization[0])
        assert written == sorted(luma_table(quality).reshape(-1).astype(int).tolist())


@pytest.mark.parametrize("quality", [10, 30, 50, 75, 88])
def test_quality_is_found(quality: int) -> None:
    found = find_quality(save(picture(), quality))
    assert found is not None
    assert np.abs(luma_table(found) - luma_table(quality)).max() <= 2


def test_uncompressed_and_shifted_pictures_have_no_quality() -> None:
    assert find_quality(picture()) is None
    assert find_quality((np.round(picture() * 255) / 255).astype(np.float32)) is None
    assert find_quality(save(picture(), 30)[3:, 5:]) is None  # its blocks begin elsewhere: `find_grid`
    assert find_quality(np.zeros((64, 64, 3), np.float32)) is None
    assert find_quality(np.zeros((5, 5, 3), np.float32)) is None


def test_tables_fit_as_their_slow_twin_says() -> None:
    tables = np.stack([luma_table(quality).reshape(-1)[1:33] for quality in (2, 30, 60, 92, 99)])
    rng = np.random.default_rng(0)
    loud = np.round(rng.normal(0.0, 2.0, (32, 90))) * tables[1][:, None] + rng.normal(0.0, 0.3, (32, 90))
    quiet = rng.normal(0.0, 1.0, (32, 90))
    for coefficients in (loud, quiet):
        fits = np.empty(len(tables))
        _fit_tables(coefficients, tables, fits)
        np.testing.assert_allclose(fits, fit_tables(coefficients, tables), rtol=1e-9)
    assert np.argmin(fit_tables(loud, tables)) == 1


@pytest.mark.parametrize("quality", [10, 40, 85])
@pytest.mark.parametrize(("top", "left"), [(0, 0), (3, 5), (0, 7), (4, 4)])
def test_blocks_are_found_wherever_they_begin(quality: int, top: int, left: int) -> None:
    """Of a picture that was cut after it was decoded."""
    found = find_grid(save(picture(1, 320), quality)[top:, left:])
    assert found is not None
    assert (found.top, found.left) == (-top % 8, -left % 8)
    assert np.abs(luma_table(found.quality) - luma_table(quality)).max() <= 2


def test_what_no_jpeg_coder_made_has_no_blocks() -> None:
    plain = picture(1, 320)
    eight_bit = (np.round(plain * 255) / 255).astype(np.float32)
    assert find_grid(plain) is None
    assert find_grid(eight_bit) is None
    assert find_grid(save(plain, 30, "WEBP")) is None
    assert find_grid(np.zeros((64, 64, 3), np.float32)) is None
    assert find_grid(np.zeros((5, 5, 3), np.float32)) is None


def test_a_part_is_put_back_where_it_was() -> None:
    grid, image = JpegGrid(10, 3, 5), picture(2)
    whole = grid.whole(grid.part(image), image.shape)
    np.testing.assert_array_equal(whole[3:, 5:], image[3:, 5:])
    assert not whole[:3].any()
    assert not whole[:, :5].any()


def test_blocks_are_an_orthonormal_transform() -> None:
    luma = 255.0 * picture(5) @ LUMA
    energy = float(((luma - 128.0) ** 2).sum())
    assert float((blocks_of(luma) ** 2).sum()) == pytest.approx(energy, rel=1e-6)
