"""A picture laid over its reference: the motion is found to a few hundredths of a pixel, or not at all."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from engine.errors import InputError
from engine.numerics.resampling import map_points, warp
from engine.pictures.alignment import planar as image_alignment
from engine.pictures.alignment.brightness_fit import Fit, fit_warp
from engine.pictures.alignment.planar import align_either_hand, align_image
from tests.pictures.image_cases import SIDE, attack, marked, picture, turn

EXACT = ["none", "jpeg10", "noise 0.01", "noise 0.1", "blur 1", "brightness 0.5", "brightness 1.5"]
MOVED = ["rotation 30", "scale 0.75", "scale 1.5", "crop", "rotation, scale, jpeg50", "squeezed"]


def error_pixels(found: np.ndarray, true: np.ndarray, size: tuple[int, int]) -> float:
    """Largest error over the reference's pixels that are in the picture, in pixels of the reference."""
    axis = np.linspace(0, SIDE, 13)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    wanted, got = map_points(true, grid), map_points(found, grid)
    inside = ((wanted >= 0) & (wanted <= [size[1], size[0]])).all(axis=1)
    return float(np.linalg.norm(wanted - got, axis=1)[inside].max() / np.sqrt(np.linalg.det(true[:2, :2])))


@pytest.mark.parametrize("name", EXACT)
def test_a_picture_in_place_is_used_without_resampling(name: str) -> None:
    case = marked()
    suspect, _ = attack(name, case.image)
    alignment = align_image(case.plain, suspect)
    assert alignment is not None
    np.testing.assert_array_equal(alignment.matrix, np.eye(3))
    np.testing.assert_array_equal(alignment.warped, suspect)
    assert alignment.mask.mean() > 0.9


@pytest.mark.parametrize(("name", "limit"), [*((name, 0.06) for name in MOVED), ("rotation, noise 0.1", 0.15)])
def test_motion_is_undone(name: str, limit: float) -> None:
    case = marked()
    suspect, true = attack(name, case.image)
    alignment = align_image(case.plain, suspect)
    assert alignment is not None
    assert error_pixels(alignment.matrix, true, suspect.shape[:2]) < limit
    assert alignment.warped.shape == case.plain.shape
    inside = np.abs(alignment.warped - case.plain)[alignment.mask]
    assert np.median(inside) < 0.08
    assert alignment.inliers > 1000


def test_a_rival_that_looks_alike_does_not_end_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Smooth stone: a cut piece, enlarged to the whole, correlated to 0.92 and was taken for it."""
    case = marked()
    suspect, true = np.ascontiguousarray(case.image[40:220, 60:240]), np.eye(3)
    true[:2, 2] = -60.0, -40.0

    def fit(*arguments: Any, **more: Any) -> Fit | None:
        found = fit_warp(*arguments, **more)
        first = more["levels"] == (8, 4) and abs(arguments[2][0, 0] - 1.0) > 0.1
        return replace(found, matrix=arguments[2], correlation=0.92) if found and first else found

    monkeypatch.setattr(image_alignment, "fit_warp", fit)
    alignment = align_image(case.plain, suspect)
    assert alignment is not None
    assert error_pixels(alignment.matrix, true, suspect.shape[:2]) < 0.06


def test_perspective_is_undone() -> None:
    from engine.numerics.resampling import warp

    case = marked()
    true = turn(4.0) @ np.array([[1.02, 0.01, 3], [0.0, 0.99, -2], [2e-4, -1e-4, 1.0]])
    suspect, _ = warp(case.image, np.linalg.inv(true), SIDE, SIDE)
    alignment = align_image(case.plain, suspect)
    assert alignment is not None
    axis = np.linspace(60, SIDE - 60, 5)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    assert np.abs(map_points(alignment.matrix, grid) - map_points(true, grid)).max() < 0.1


def test_mask_leaves_out_black_corners_and_captions() -> None:
    case = marked()
    suspect, _ = attack("rotation 30", case.image)
    alignment = align_image(case.plain, suspect)
    assert alignment is not None
    # Four corners of the picture lie in the cut-off triangles of a square turned by 30 degrees.
    assert not alignment.mask[[0, 0, -1, -1], [0, -1, 0, -1]].any()
    assert alignment.mask.mean() > 0.7
    captioned = case.image.copy()
    captioned[200:240, 60:180] = 1.0
    alignment = align_image(case.plain, captioned)
    assert alignment is not None
    assert not alignment.mask[200:240, 60:180].any()
    assert alignment.mask[:180].mean() > 0.95


def test_another_picture_does_not_fit() -> None:
    assert align_image(picture(0), picture(1)) is None
    assert align_image(picture(0), np.random.default_rng(0).random((200, 240, 3)).astype(np.float32)) is None


@pytest.mark.parametrize("shape", [(1, 1, 3), (3, 5, 3), (40, 2, 3)])
def test_tiny_and_empty_pictures_are_answered(shape: tuple[int, ...]) -> None:
    align_image(picture(0), np.zeros(shape, dtype=np.float32))
    align_image(np.zeros(shape, dtype=np.float32), picture(0))
    assert align_image(np.zeros((64, 64, 3), np.float32), np.zeros((64, 64, 3), np.float32)) is None


def test_same_input_same_answer() -> None:
    case = marked()
    suspect, _ = attack("rotation, scale, jpeg50", case.image)
    a, b = align_image(case.plain, suspect), align_image(case.plain, suspect)
    assert a is not None
    assert b is not None
    np.testing.assert_array_equal(a.matrix, b.matrix)
    np.testing.assert_array_equal(a.warped, b.warped)


def test_bad_input_is_refused() -> None:
    with pytest.raises(InputError, match=r"\(300, 300\)"):
        align_image(picture(0), picture(0)[..., 0])
    broken = picture(0).copy()
    broken[0, 0, 0] = np.nan
    with pytest.raises(InputError, match="finite"):
        align_image(picture(0), broken)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("name", ["jpeg10", "rotation 30"])
def test_a_picture_turned_over_is_read_as_it_was(name: str, axis: int) -> None:
    case = marked()
    suspect, _ = attack(name, case.image)
    own, other = align_image(case.plain, suspect), align_either_hand(case.plain, np.flip(suspect, axis))
    assert own is not None
    assert other is not None
    assert not own.mirrored
    assert other.mirrored
    assert other.correlation == pytest.approx(own.correlation, abs=0.01)
    both = own.mask & other.mask
    assert both.mean() > 0.5
    assert np.abs(own.warped - other.warped)[both].mean() < 0.01


def test_only_a_picture_that_fits_badly_is_turned_over(monkeypatch: pytest.MonkeyPatch) -> None:
    case = marked()
    suspect, _ = attack("noise 0.1", case.image)
    asked: list[np.ndarray] = []
    monkeypatch.setattr(image_alignment, "align_image", lambda r, s: asked.append(s) or align_image(r, s))
    found = align_either_hand(case.plain, suspect)
    assert found is not None
    assert not found.mirrored
    assert len(asked) == 1
    assert align_either_hand(case.plain, picture(seed=9)) is None or len(asked) == 4


def test_a_motion_that_coarse_jpeg_makes_up_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of four views of a guitar at JPEG 10 two were moved by 0.1 pixels, which lost them the coder's grid."""
    case = marked()
    made_up = np.eye(3)
    made_up[0, 2] = 0.1

    def fitted(*images: Any, **how: Any) -> Fit | None:
        fit = fit_warp(*images, **how)
        return None if fit is None else replace(fit, matrix=fit.matrix @ made_up)

    monkeypatch.setattr(image_alignment, "fit_warp", fitted)
    compressed, _ = attack("jpeg10", case.image)
    still = align_image(case.plain, compressed)
    assert still is not None
    np.testing.assert_array_equal(still.matrix, np.eye(3))
    monkeypatch.undo()
    true = np.eye(3)
    true[0, 2] = 0.25
    alignment = align_image(case.plain, warp(case.image, np.linalg.inv(true), SIDE, SIDE)[0])
    assert alignment is not None
    assert np.abs(alignment.matrix[:2, 2] - [0.25, 0.0]).max() < 0.05
