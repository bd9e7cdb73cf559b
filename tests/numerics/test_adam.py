"""Adam: against Kingma and Ba's formulas in float64."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.numerics import adam
from engine.numerics.adam import AdamMoments, adam_step
from tests.reference import training as twin
from tests.threads import with_one_and_two_threads


def run(parameter: np.ndarray, gradients: list[np.ndarray], **rates: float) -> np.ndarray:
    result, moments = parameter.copy(), AdamMoments.zeros(parameter)
    for step, gradient in enumerate(gradients, 1):
        adam_step(result, gradient, moments, step=step, **rates)
    return result


@pytest.mark.parametrize("shape", [(7,), (5000, 3), (1100, 16, 3), (3, 1, 3)])
def test_against_the_formulas(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    parameter = rng.normal(size=shape).astype(np.float32)
    gradients = [(1e-7 * rng.normal(size=shape)).astype(np.float32) for _ in range(4)]
    rates = np.full(shape, 0.01)
    rest = {}
    if len(shape) == 3:
        rates[:, 1:] = 0.0005
        rest = {"rate_rest": 0.0005}
    moved = run(parameter, gradients, rate=0.01, **rest) - parameter
    wide = parameter.astype(np.float64)
    expected = twin.adam(wide, [g.astype(np.float64) for g in gradients], rates) - wide
    assert np.abs(expected).min(axis=tuple(range(1, len(shape)))).max() > 1e-4
    np.testing.assert_allclose(moved, expected, rtol=1e-3, atol=1e-6)


def test_compiled_equals_python() -> None:
    rng = np.random.default_rng(1)
    arrays = [rng.uniform(0.5, 1.0, 60).astype(np.float32) for _ in range(4)]
    copies = [a.copy() for a in arrays]
    numbers = (12, 3, np.float32(0.1), np.float32(0.02), np.float32(1e-15))
    adam._update(*arrays, *numbers)
    adam._update.py_func(*copies, *numbers)
    for array, copy in zip(arrays, copies, strict=True):
        np.testing.assert_allclose(array, copy, rtol=1e-6)


def test_same_bits_on_one_thread() -> None:
    rng = np.random.default_rng(2)
    parameter = rng.normal(size=(3000, 16, 3)).astype(np.float32)
    gradients = [rng.normal(size=parameter.shape).astype(np.float32)]
    one, two = with_one_and_two_threads(lambda: run(parameter, gradients, rate=0.01, rate_rest=0.001))
    assert one.tobytes() == two.tobytes()


def test_a_zero_gradient_moves_nothing() -> None:
    parameter = np.ones((4, 3), np.float32)
    assert (run(parameter, [np.zeros((4, 3), np.float32)] * 3, rate=0.1) == parameter).all()


def test_refusals() -> None:
    parameter = np.ones((4, 3), np.float32)
    with pytest.raises(InputError, match="one shape"):
        adam_step(parameter, np.ones((3, 3), np.float32), AdamMoments.zeros(parameter), 0.1, 1)
    with pytest.raises(InputError, match="step is 0"):
        adam_step(parameter, parameter, AdamMoments.zeros(parameter), 0.1, 0)
