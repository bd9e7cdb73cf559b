"""The solver's steps, on laws of how quality falls with strength; scenes are in the tests of embedding."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from engine.pipeline import strength
from engine.pipeline.strength import Strength, solve_strength


@pytest.mark.parametrize("power", [2.0, 3.0, 5.0])
@pytest.mark.parametrize("start", [0.01, 1.0, 30.0])
def test_both_targets_are_met_and_nearly_reached(monkeypatch: pytest.MonkeyPatch, power: float, start: float) -> None:
    """SSIM that falls with another power of the factor than the second must not throw the solver off."""

    def measure(views: Any, displacement: Any, factor: float) -> Strength:
        return Strength(factor, 50.0 - 20 * np.log10(factor), 1.0 - 1e-3 * factor**power)

    monkeypatch.setattr(strength, "_measure", measure)
    found = solve_strength(None, np.zeros((1, 3), np.float32), 40.0, 0.996, start)  # type: ignore[arg-type]
    assert found.psnr_db >= 40.0
    assert found.ssim >= 0.996
    best = min(10**0.5, 4.0 ** (1 / power))
    assert 0.9 * best < found.factor <= best
