"""The solver's steps, on laws of how quality falls with strength and on a small scene."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from engine.flows.embed import layer_strengths as strength
from engine.flows.embed.layer_strengths import Strength, add_dc, first_guess, solve_strength
from engine.model import look_at
from engine.numerics.image_metrics import psnr, ssim
from engine.raster import render
from tests.watermark.ball import marked_ball


@pytest.mark.parametrize("power", [2.0, 3.0, 5.0])
@pytest.mark.parametrize("start", [0.01, 1.0, 30.0])
def test_both_targets_are_met_and_nearly_reached(monkeypatch: pytest.MonkeyPatch, power: float, start: float) -> None:
    """SSIM that falls with another power of the factor than the second must not throw the solver off."""

    def measure(views: Any, displacement: Any, factor: float) -> Strength:
        return Strength(50.0 - 20 * np.log10(factor), 1.0 - 1e-3 * factor**power, factor)

    monkeypatch.setattr(strength, "_measure", measure)
    found = solve_strength(None, np.zeros((1, 3), np.float32), 40.0, 0.996, start)  # type: ignore[arg-type]
    assert found.psnr_db >= 40.0
    assert found.ssim >= 0.996
    best = min(10**0.5, 4.0 ** (1 / power))
    assert 0.9 * best < found.factor <= best


def test_the_first_guess_meets_the_target_where_chips_do_not_meet() -> None:
    energies = np.array([[1.0, 2.0], [5.0, 4.0]])  # squared image displacement by view and chip, at factor 1
    camera = look_at((0, 0, -3), (0, 0, 0), (0, -1, 0), 50.0, 30, 20)
    factor = first_guess(energies, [camera, camera], 47.0)
    mean_squared = factor**2 * 9.0 / (3 * 30 * 20)
    assert -10 * np.log10(mean_squared) == pytest.approx(47.0)


def test_what_is_measured_is_the_worst_view_of_the_marked_model() -> None:
    ball = marked_ball(size=64)
    displacement = ball.displacement.copy()
    displacement[ball.model.means[:, 0] > 0] *= 3.0  # so that views differ
    found = solve_strength(ball.original, displacement, 40.0, 0.9, 1.0)
    sh = ball.model.sh.copy()
    sh[:, 0] += np.float32(found.factor) * displacement
    renders = [render(ball.model.with_(sh=sh), camera) for camera in ball.cameras]
    pairs = list(zip(ball.original.images, renders, strict=True))
    assert max(psnr(*pair) for pair in pairs) > found.psnr_db + 0.1
    assert found.psnr_db == pytest.approx(min(psnr(*pair) for pair in pairs), abs=1e-3)
    assert found.ssim == pytest.approx(min(ssim(*pair) for pair in pairs), abs=1e-5)
    assert 40.0 <= found.psnr_db < 40.06
    np.testing.assert_array_equal(add_dc(ball.model.sh, np.float32(found.factor) * displacement), sh)
