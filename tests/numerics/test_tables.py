"""Functions looked up in a table are those that numpy interpolates."""

from __future__ import annotations

import numpy as np
import pytest

from engine.numerics.tables import look_up


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_it_is_numpys_interpolation(dtype: type) -> None:
    rng = np.random.default_rng(0)
    image = rng.normal(0.5, 0.6, (40, 30)).astype(dtype)
    values = rng.random(65)
    expected = np.interp(image, np.linspace(-0.2, 1.1, 65), values)
    np.testing.assert_allclose(look_up(image, -0.2, 1.1, values), expected, rtol=0, atol=1e-5)


def test_it_is_constant_beyond_and_exact_at_the_ends() -> None:
    image = np.array([[-np.inf, -3.0, 0.0, 1.0, 7.0, np.inf]])
    assert look_up(image, 0.0, 1.0, np.array([2.0, 5.0, 3.0])).tolist() == [[2.0, 2.0, 2.0, 3.0, 3.0, 3.0]]
