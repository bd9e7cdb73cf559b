"""The loss against its twin, its gradient against autograd of the twin, and against the metric."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from engine.errors import InputError
from engine.lab.sim.capture import photo_loss as module
from engine.lab.sim.capture.photo_loss import photo_loss
from engine.numerics.image_metrics import ssim
from tests.reference import training as twin


def pair(height: int = 23, width: int = 19, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    photo = rng.uniform(0.0, 1.0, (height, width, 3))
    return (photo + rng.normal(0.0, 0.1, photo.shape)).astype(np.float32), photo.astype(np.float32)


@pytest.mark.parametrize("weight", [0.0, 0.2, 1.0])
def test_against_autograd_of_the_twin(weight: float) -> None:
    image, photo = pair()
    variable = torch.tensor(image, dtype=torch.float64, requires_grad=True)
    expected = twin.photo_loss(variable, torch.tensor(photo, dtype=torch.float64), weight)
    expected.backward()
    loss, gradient = photo_loss(image, photo, weight)
    assert loss == pytest.approx(expected.item(), rel=1e-5)
    slope = variable.grad.numpy()
    assert np.linalg.norm(gradient - slope) <= 1e-5 * np.linalg.norm(slope)


def test_it_is_the_metric() -> None:
    image, photo = pair(40, 60)
    image = np.clip(image, 0.0, 1.0)
    assert photo_loss(image, photo, 1.0)[0] == pytest.approx(1.0 - ssim(image, photo), abs=1e-6)


def test_equal_images_have_no_loss_and_no_slope() -> None:
    _, photo = pair()
    loss, gradient = photo_loss(photo.copy(), photo)
    assert abs(loss) < 1e-6
    assert np.abs(gradient).max() < 1e-9


def test_refusals() -> None:
    image, photo = pair()
    with pytest.raises(InputError, match="must both be"):
        photo_loss(image, photo[:-1])
    with pytest.raises(InputError, match="ssim_weight is 2"):
        photo_loss(image, photo, 2.0)
    with pytest.raises(InputError, match="at least 11x11 pixels, got 19x8"):
        photo_loss(image[:8], photo[:8])


def test_compiled_equals_python() -> None:
    image, photo = pair(13, 12)
    x, y = image.reshape(13, -1), photo.reshape(13, -1)
    weights = np.full(11, 1 / 11, np.float32)
    results = []
    for unwrap in (lambda f: f, lambda f: f.py_func):
        across, slopes = np.empty((13, 4, 6), np.float32), np.empty((3, 3, 6), np.float32)
        gradient, sums = np.empty_like(x), np.zeros((13, 2))
        unwrap(module._filter_across)(x, y, weights, 3, across)
        unwrap(module._compare_windows)(across, weights, slopes, sums)
        numbers = np.float32(0.1), np.float32(0.05)
        unwrap(module._pull_back)(x, y, weights, 3, slopes, *numbers, gradient, sums)
        results.append((gradient, sums))
    for compiled, plain in zip(*results, strict=True):
        np.testing.assert_allclose(compiled, plain, rtol=1e-4, atol=1e-5)
