from __future__ import annotations

import numpy as np
import pytest

from engine.flows.verify.reference_views import seen_shift
from engine.model import look_at
from engine.raster import sh_colors
from tests.formats.models import random_model


@pytest.mark.parametrize("coefficients", [1, 4, 16])
def test_a_shift_is_what_displaced_harmonics_add(coefficients: int) -> None:
    model = random_model(3, 300)
    bright = model.sh.copy()
    bright[:, 0] += 20.0  # nothing is held at black
    tint = np.random.default_rng(0).normal(scale=0.1, size=(300, 3 * coefficients)).astype(np.float32)
    displaced = bright.copy()
    displaced[:, :coefficients] += tint.reshape(300, coefficients, 3)
    camera = look_at((0.3, -0.2, -9.0), (0.0, 0.0, 0.0), (0.0, -1.0, 0.0), 100.0, 96, 96)
    before, after = (sh_colors(sh, model.means, camera.position) for sh in (bright, displaced))
    np.testing.assert_allclose(seen_shift(tint, model, camera), after - before, atol=2e-5)
