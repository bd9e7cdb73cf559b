"""Growth and sizes with known answers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from engine.flows.views.camera_rig import measure_extent
from engine.formats import read_model
from engine.lab.evaluate.cost.cost_cells import sized
from engine.lab.evaluate.cost.cost_charts import fit_growth

PLANT = Path(__file__).parents[3] / "data" / "plant.splat"


def test_a_power_law_is_found_and_its_interval_covers() -> None:
    sizes = [1e4, 1e5, 1e6, 4e6]
    exact = fit_growth(sizes, [3e-6 * size**0.9 for size in sizes])
    assert exact.exponent == pytest.approx(0.9)
    assert exact.factor == pytest.approx(3e-6)
    covered = 0
    for seed in range(200):
        noise = np.exp(np.random.default_rng(seed).normal(0.0, 0.1, 4))
        found = fit_growth(sizes, [float(size * factor) for size, factor in zip(sizes, noise, strict=True)])
        assert found.interval is not None
        covered += found.interval[0] <= 1.0 <= found.interval[1]
    assert 0.88 <= covered / 200 <= 0.99


def test_two_points_have_no_interval() -> None:
    found = fit_growth([1, 10], [1, 100])
    assert found.interval is None
    assert str(found) == "2.00"
    with pytest.raises(ValueError, match="two sizes"):
        fit_growth([5, 5], [1, 2])
    with pytest.raises(ValueError, match="positive"):
        fit_growth([1, 2], [0.0, 1.0])


def test_scenes_of_any_size() -> None:
    model = read_model(PLANT).model.take(np.arange(0, 113_000, 100))
    thin = sized(model, 500)
    assert len(thin) == 500
    rows = {tuple(row) for row in model.means.tolist()}
    assert {tuple(row) for row in thin.means.tolist()} <= rows
    large = sized(model, 3_000)
    assert len(large) == 3_000
    assert np.isfinite(large.means).all()
    # Copies stand apart: the whole is wider than one, and each has the shape of the first.
    assert measure_extent(large).radius > 1.3 * measure_extent(model).radius
    count = len(model)
    widths = [np.ptp(large.means[k * count : (k + 1) * count, 1]) for k in range(2)]
    assert widths[0] == pytest.approx(widths[1], rel=1e-4)
    assert (sized(model, 3_000).means == large.means).all()
