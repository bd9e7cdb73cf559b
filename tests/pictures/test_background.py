"""What lies behind a model in a picture."""

from __future__ import annotations

import numpy as np
import pytest

from engine.pictures.alignment.background import fill_background, find_background


def disc(height: int, width: int, radius: float) -> np.ndarray:
    """Opacity of a round model with a soft edge."""
    y, x = np.mgrid[:height, :width] + 0.5
    return np.clip(radius - np.hypot(x - width / 2, y - height / 2), 0.0, 1.0).astype(np.float32)


@pytest.fixture(scope="module")
def alpha() -> np.ndarray:
    return disc(120, 160, 40.0) * np.float32(0.8)


def shown(alpha: np.ndarray, behind: np.ndarray) -> np.ndarray:
    return (alpha[..., None] * np.float32([0.2, 0.5, 0.3]) + (1.0 - alpha[..., None]) * behind).astype(np.float32)


def test_a_colour_and_a_gradient_shine_through_as_they_are(alpha: np.ndarray) -> None:
    across = np.linspace(0.2, 0.9, 160, dtype=np.float32)[None, :, None]
    for behind in (np.ones((120, 160, 3), np.float32), np.broadcast_to(across, (120, 160, 3))):
        found = find_background(shown(alpha, behind), alpha)
        assert found is not None
        own = shown(alpha, behind) - found.through
        np.testing.assert_allclose(own[alpha > 0.1], shown(alpha, np.zeros(3))[alpha > 0.1], atol=0.04)
        assert found.trusted[alpha > 0.7].all()
        assert not found.trusted[alpha < 0.01].any()


def test_what_a_photograph_shows_is_not_guessed(alpha: np.ndarray) -> None:
    rng = np.random.default_rng(0)
    rough = np.kron(rng.random((12, 16, 3)), np.ones((10, 10, 1))).astype(np.float32)
    found = find_background(shown(alpha, rough), alpha)
    assert found is not None
    assert found.trusted[alpha > 0.1].mean() < 0.5  # a fifth of it shines through everywhere
    assert not found.trusted[(alpha > 0.1) & (alpha < 0.6)].any()
    solid = alpha / np.float32(0.8)
    assert find_background(shown(solid, rough), solid).trusted[solid > 0.99].all()


def test_black_and_what_nobody_sees_are_no_background(alpha: np.ndarray) -> None:
    assert find_background(shown(alpha, np.zeros(3)), alpha) is None
    everywhere = np.ones((40, 40), np.float32)
    assert fill_background(np.ones((40, 40), np.float32), everywhere) is None
    assert find_background(np.ones((40, 40, 3), np.float32), everywhere) is None


def test_pixels_near_the_model_do_not_speak(alpha: np.ndarray) -> None:
    """The camera may be off by some pixels: what the model shows there must not run into the background."""
    picture = np.where(disc(120, 160, 44.0)[..., None] > 0, np.float32(0.0), np.float32(1.0)) * np.ones(3, np.float32)
    filled = fill_background(picture, alpha, margin=8)
    assert filled is not None
    np.testing.assert_allclose(filled, 1.0, atol=1e-5)
    near = fill_background(picture, alpha, margin=1)
    assert near is not None
    assert near.min() < 0.9


def test_planes_are_filled_alike(alpha: np.ndarray) -> None:
    picture = np.random.default_rng(1).random((120, 160, 3)).astype(np.float32)
    filled = fill_background(picture, alpha)
    for c in range(3):
        np.testing.assert_allclose(filled[..., c], fill_background(picture[..., c], alpha), atol=1e-6)
