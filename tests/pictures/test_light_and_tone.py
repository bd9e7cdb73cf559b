"""What happened to the colours of a picture is found and taken off: uneven light, strong tone curves, both."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from engine.lab.sim.attacks import image_attack
from engine.pictures.alignment.planar import align_image
from engine.pictures.alignment.residual import image_cotangent
from engine.pictures.alignment.tone_and_light import _clipped_mean, fit_colors, fit_light, predict_brightness
from tests.pictures.image_cases import SIDE, marked, picture, z_score

LUMA = np.array([0.299, 0.587, 0.114], dtype=np.float32)
WHOLE = np.ones((SIDE, SIDE), dtype=bool)


@cache
def uneven(kind: str) -> np.ndarray:
    height, width = WHOLE.shape
    y, x = np.mgrid[:height, :width] / float(height) - 0.5
    if kind == "vignette":
        return (1.0 - 0.8 * (x**2 + y**2)).astype(np.float32)
    if kind == "rolling":
        return (0.75 + 0.4 * y).astype(np.float32) + 0 * x.astype(np.float32)
    return (1.0 + 0.15 * np.sin(2 * np.pi * 5 * y)).astype(np.float32)  # flicker


@pytest.mark.parametrize("kind", ["vignette", "rolling", "flicker"])
def test_the_gain_is_found_up_to_a_constant(kind: str) -> None:
    plain, gain = picture() @ LUMA, uneven(kind)
    noise = np.random.default_rng(0).normal(0.0, 0.01, plain.shape).astype(np.float32)
    found = fit_light(plain, plain * gain + noise, WHOLE)
    assert found is not None
    ratio = found / gain
    assert ratio.std() / ratio.mean() < 0.4 * gain.std() / gain.mean()  # the rest in the next round, after the tone


def test_even_light_is_left_alone() -> None:
    plain = picture() @ LUMA
    noise = np.random.default_rng(0).normal(0.0, 0.02, plain.shape).astype(np.float32)
    assert fit_light(plain, plain + noise, WHOLE) is None
    assert fit_light(plain, plain, np.zeros_like(WHOLE)) is None


def test_over_a_small_object_the_light_does_not_run_away() -> None:
    """There the smooth functions add up to a constant, which gain and tone could trade for ever."""
    plain = np.zeros_like(picture())
    plain[60:110, 70:120] = 0.2 + 0.6 * picture()[60:110, 70:120]
    lit = plain.max(axis=2) > 0
    y, x = np.mgrid[: plain.shape[0], : plain.shape[1]] / 12.0
    seen = plain * (1.0 + 0.03 * np.sin(x) * np.cos(y))[..., None].astype(np.float32)
    toned = fit_colors(plain, seen, WHOLE)
    assert np.abs(toned.slope[lit] - 1.0).max() < 0.3
    assert np.abs(toned.predicted - seen)[lit].max() < np.abs(plain - seen)[lit].max() + 0.02


@pytest.mark.parametrize(
    ("name", "strength"),
    [("gamma", 2.2), ("gamma", 0.33), ("filmic", 4.0), ("viewer_color", "srgb_twice"), ("vignette", 0.7)],
)
def test_colours_are_predicted(name: str, strength: float | str) -> None:
    plain = picture()
    seen = image_attack(name).apply(plain, strength)
    change = np.sqrt(np.mean((seen - plain) ** 2))
    left = np.sqrt(np.mean((fit_colors(plain, seen, WHOLE).predicted - seen) ** 2))
    assert left < 0.06 * change


def test_a_caption_does_not_move_the_brightness() -> None:
    """Judging what is evidence: the curve and the light are found under a painted tenth of the picture."""
    plain = picture() @ LUMA
    lit = (plain**0.5 * uneven("vignette")).astype(np.float32)
    seen = lit.copy()
    seen[:60, :150] = 1.0
    predicted = predict_brightness(plain, seen, WHOLE)
    rest = np.ones_like(WHOLE)
    rest[:60, :150] = False
    assert np.abs(predicted - lit)[rest].mean() < 0.02
    assert np.median(np.abs(predicted - seen)[~rest]) > 0.1


@pytest.mark.parametrize(
    ("name", "strength", "least"),
    [
        ("vignette", 0.7, 38),
        pytest.param("rolling_exposure", 0.8, 33, marks=pytest.mark.long),
        pytest.param("flicker", 0.2, 36, marks=pytest.mark.long),
        ("gamma", 2.2, 24),
        pytest.param("gamma", 0.33, 38, marks=pytest.mark.long),
    ],
)
def test_the_mark_is_read_through_it(name: str, strength: float, least: float) -> None:
    case = marked()
    seen = np.round(image_attack(name).apply(case.image, strength) * 255).astype(np.float32) / 255
    alignment = align_image(case.plain, seen)
    assert alignment is not None
    y = case.read(image_cotangent(case.plain, alignment.warped, alignment.mask))
    z = z_score(y, case.chips)
    assert z > least, z
    chips = np.random.default_rng(5).choice([-1.0, 1.0], (5_000, len(y)))
    assert (chips @ y / np.linalg.norm(y)).max() < 6


def test_what_noise_and_clipping_leave_of_a_level_is_its_mean() -> None:
    """E[clip(u + n, 0, 1)] and its derivative, against a million draws."""
    levels, noise = np.linspace(-0.1, 1.1, 13), 0.05
    value, keep = _clipped_mean(levels, noise)
    draws = noise * np.random.default_rng(0).standard_normal(1_000_000)
    for level, mean, slope in zip(levels, value, keep, strict=True):
        shown = level + draws
        assert mean == pytest.approx(np.clip(shown, 0.0, 1.0).mean(), abs=3e-4)
        assert slope == pytest.approx(((shown > 0.0) & (shown < 1.0)).mean(), abs=3e-3)
