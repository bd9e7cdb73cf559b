"""Each image attack does what its strength says, measured on the pixels."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from engine.lab.sim.attacks import IMAGE_ATTACKS, image_attack
from engine.model import Float32
from engine.numerics.image_metrics import psnr


def run(name: str, image: Float32, strength: float | None = None, seed: int = 0, **options: object) -> Float32:
    return image_attack(name).apply(image, strength, rng=seed, **options)


def test_jpeg_is_what_an_encoder_with_half_size_chroma_makes(image: Float32) -> None:
    buffer = io.BytesIO()
    Image.fromarray(np.round(image * 255).astype(np.uint8)).save(buffer, "JPEG", quality=50, subsampling=2)
    expected = np.asarray(Image.open(buffer)).astype(np.float32) / 255
    np.testing.assert_array_equal(run("jpeg", image, 50), expected)


def test_worse_jpeg_is_worse(image: Float32) -> None:
    quality = [psnr(image, run("jpeg", image, q)) for q in (95, 50, 10)]
    assert quality == sorted(quality, reverse=True)
    assert quality[0] > 30
    assert quality[2] < 30


@pytest.mark.parametrize(("reading", "std"), [("literal", 0.1), ("as_code", 0.01)])
def test_noise_has_its_std_and_is_clipped(reading: str, std: float) -> None:
    grey = np.full((100, 100, 3), 0.5, dtype=np.float32)
    noise = run("noise_image", grey, reading=reading) - grey
    assert noise.std() == pytest.approx(std, rel=0.02)
    assert abs(noise.mean()) < 4 * std / np.sqrt(noise.size)
    assert abs(np.corrcoef(noise[..., 0].ravel(), noise[..., 1].ravel())[0, 1]) < 0.05
    white = run("noise_image", np.ones((50, 50, 3), dtype=np.float32), reading=reading)
    assert white.max() == 1.0
    assert 1 - 6 * std < white.min() < 1.0  # clipped at white, not wrapped to black


def test_blur_is_a_gaussian_of_its_sigma() -> None:
    point = np.zeros((41, 41, 3), dtype=np.float32)
    point[20, 20] = 1.0
    out = run("blur", point, 2.0)
    offsets = np.arange(41) - 20
    profile = out[..., 0].sum(axis=0).astype(np.float64)
    assert profile.sum() == pytest.approx(1.0, abs=1e-4)
    assert (profile * offsets**2).sum() == pytest.approx(4.0, rel=0.01)
    np.testing.assert_allclose(out[..., 0], out[..., 0].T, atol=1e-7)
    np.testing.assert_array_equal(run("blur", point, 0.0), point)


def test_blur_as_code_reaches_one_pixel() -> None:
    point = np.zeros((15, 15, 3), dtype=np.float32)
    point[7, 7] = 1.0
    out = run("blur", point, 0.8, reading="as_code")
    assert np.count_nonzero(out[..., 0]) == 9
    # Sigma 0.1, as some of that code declares, changes nothing one could see.
    np.testing.assert_allclose(run("blur", point, 0.1, reading="as_code"), point, atol=1e-6)


def test_rotation_by_a_right_angle_is_exact() -> None:
    square = np.random.default_rng(0).random((33, 33, 3), dtype=np.float32)
    np.testing.assert_allclose(run("rotate_image", square, 90.0), np.rot90(square), atol=1e-5)


def test_rotation_keeps_the_canvas_and_blackens_corners(image: Float32) -> None:
    out = run("rotate_image", image, 30.0)
    assert out.shape == image.shape
    assert (out[0, 0] == 0).all()
    assert (out[-1, -1] == 0).all()
    center = image.shape[0] // 2, image.shape[1] // 2
    back = run("rotate_image", out, -30.0)
    region = slice(center[0] - 12, center[0] + 12), slice(center[1] - 12, center[1] + 12)
    assert psnr(back[region], image[region]) > 28
    assert psnr(out[region], image[region]) < 22


def test_rotation_as_code_draws_the_angle(image: Float32) -> None:
    angle = float(np.random.default_rng(3).uniform(-30, 30))
    expected = run("rotate_image", image, angle)
    np.testing.assert_array_equal(run("rotate_image", image, 30.0, seed=3, reading="as_code"), expected)


def test_mirrored_pictures(image: Float32) -> None:
    np.testing.assert_array_equal(run("mirror_image", image), image[:, ::-1])
    np.testing.assert_array_equal(run("mirror_image", image, "up-down"), image[::-1])
    np.testing.assert_array_equal(run("mirror_image", image, "diagonal"), image.transpose(1, 0, 2))


def test_scale_changes_both_sides_and_averages(image: Float32) -> None:
    half = run("scale_image", image, 0.5)
    blocks = image.reshape(36, 2, 48, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(half, blocks, atol=1e-5)
    assert run("scale_image", image, 0.75).shape == (54, 72, 3)
    assert run("scale_image", image, 1.5).shape == (108, 144, 3)
    assert run("scale_image", image, 0.75, reading="as_code").shape == (62, 83, 3)


def test_crop_is_a_window_of_the_image_at_a_random_place(image: Float32) -> None:
    corners = set()
    for seed in range(8):
        piece = run("crop_image", image, 0.4, seed=seed)
        height, width = piece.shape[:2]
        assert height / width == pytest.approx(image.shape[0] / image.shape[1], rel=0.03)
        windows = np.lib.stride_tricks.sliding_window_view(image, piece.shape)[:, :, 0]
        found = np.argwhere((windows == piece).all(axis=(2, 3, 4)))
        assert len(found) == 1
        corners.add(tuple(found[0]))
    assert len(corners) > 4


def test_crop_as_code_keeps_the_centre(image: Float32) -> None:
    piece = run("crop_image", image, 0.5, reading="as_code")
    np.testing.assert_array_equal(piece, image[18:54, 24:72])


def test_brightness_multiplies_and_clips(image: Float32) -> None:
    np.testing.assert_allclose(run("brightness", image, 0.5), 0.5 * image, atol=1e-7)
    np.testing.assert_allclose(run("brightness", image, 2.0), np.minimum(2 * image, 1), atol=1e-6)


@pytest.mark.parametrize("name", ["jpeg", "noise_image", "blur"])
def test_grids_run_from_harmless_to_ruinous(name: str, image: Float32) -> None:
    attack = IMAGE_ATTACKS[name]
    quality = [psnr(image, attack.apply(image, strength)) for strength in attack.grid]
    assert quality == sorted(quality, reverse=True)
    assert quality[0] > 30
    assert quality[-1] < 22


def test_results_do_not_alias_the_input(image: Float32) -> None:
    for name, strength in (("crop_image", 0.0), ("blur", 0.0), ("brightness", 1.0), ("scale_image", 1.0)):
        assert not np.shares_memory(run(name, image, strength), image)


def test_lettering_covers_the_same_of_a_picture_of_any_size() -> None:
    grey = np.full((240, 320, 3), 0.4, dtype=np.float32)
    small, large = (run("lettering", np.tile(grey, (k, k, 1)), 0.5) for k in (1, 3))
    for out in (small, large):
        covered = (out - 0.4) / (0.5 * 0.6)
        assert covered.min() == pytest.approx(0.0, abs=1e-6)
        assert covered.max() == pytest.approx(1.0, abs=1e-5)
        quarters = [part.mean() for half in np.array_split(covered, 2) for part in np.array_split(half, 2, axis=1)]
        assert 0.06 < min(quarters) < max(quarters) < 0.25
    assert small.mean() == pytest.approx(large.mean(), abs=0.02)
    np.testing.assert_array_equal(run("lettering", grey, 0.0), grey)


def test_chequers_are_as_strong_as_they_say_and_change_no_mean() -> None:
    grey = np.full((352, 352, 3), 0.5, dtype=np.float32)
    board = run("chequers", grey, 0.04) - grey
    assert psnr(grey, grey + board) == pytest.approx(-20.0 * np.log10(0.04), abs=0.01)
    assert abs(board.mean()) < 0.002
    changes = np.flatnonzero(np.diff(np.sign(board[0, :, 0])))
    assert np.diff(changes).mean() == pytest.approx(0.011 * 352, abs=0.1)
