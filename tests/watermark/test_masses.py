"""Gaussians that hold still because very many share their value."""

from __future__ import annotations

import numpy as np
import pytest

from engine.watermark.keys import OwnerKey
from engine.watermark.secret_cells import OWNER, cells_key, find_masses, multiples


def test_a_value_in_one_channel_that_many_share_is_a_mass() -> None:
    dc = np.random.default_rng(0).normal(0.0, 1.0, (1000, 3)).astype(np.float32)
    dc[:30, 1] = 6.0
    dc[30:45, 2] = -6.0
    still = find_masses(dc, 0.02)
    assert still[:30].all(), "30 of 1000 are more than 2 %"
    assert not still[30:].any(), "15 of 1000 are not"
    assert not find_masses(dc, 1.0).any()


def test_what_many_share_because_values_are_few_is_no_mass() -> None:
    rng = np.random.default_rng(2)
    dc = (np.round(8.0 * rng.normal(0.0, 1.0, (20_000, 3))) / 8.0).astype(np.float32)
    dc[:800, 0] = -1.5
    still = find_masses(dc, 0.005)
    assert np.array_equal(still, dc[:, 0] == -1.5), "0.0 has 5 % by nature, -1.5 has 6 where 2 are usual"


def test_rounding_below_the_references_grid_does_not_hide_a_mass() -> None:
    rng = np.random.default_rng(1)
    dc = rng.normal(0.0, 1.0, (1000, 3)).astype(np.float32)
    dc[:100, 0] = 0.5 + rng.uniform(-1e-4, 1e-4, 100)
    assert find_masses(dc, 0.05)[:100].all()


def test_masses_take_no_part_in_any_displacement_and_the_others_each_a_part_of_its_own() -> None:
    still = np.zeros(4_000, dtype=bool)
    still[:100] = True
    times = multiples(cells_key(OwnerKey(bytes(range(32))), b"x" * 32, OWNER), still)
    assert not times[:100].any()
    assert 0.47 < times[100:].min() < 0.5 < 1.4 < times.max() < 1.45
    assert np.mean(times[100:] ** 2) == pytest.approx(1.0, abs=0.02)
    assert len(np.unique(times)) > 100


def test_a_scene_that_is_nearly_one_mass_is_marked_all_over() -> None:
    dc = np.random.default_rng(3).normal(0.0, 1.0, (1000, 3)).astype(np.float32)
    for share, held in ((0.6, True), (0.8, False)):
        dc[: int(share * 1000), 0] = 1.75
        assert find_masses(dc, 0.02).any() == held
