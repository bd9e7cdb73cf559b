"""Gaussians that hold still because very many share their value."""

from __future__ import annotations

import numpy as np

from engine.compress.hvq import Stage
from engine.watermark.masses import find_masses, set_aside, spare_masses


def test_a_value_in_one_channel_that_many_share_is_a_mass() -> None:
    dc = np.random.default_rng(0).normal(0.0, 1.0, (1000, 3)).astype(np.float32)
    dc[:30, 1] = 6.0
    dc[30:45, 2] = -6.0
    still = find_masses(dc, 0.02)
    assert still[:30].all(), "30 of 1000 are more than 2 %"
    assert not still[30:].any(), "15 of 1000 are not"
    assert not find_masses(dc, 1.0).any()


def test_rounding_below_the_references_grid_does_not_hide_a_mass() -> None:
    rng = np.random.default_rng(1)
    dc = rng.normal(0.0, 1.0, (1000, 3)).astype(np.float32)
    dc[:100, 0] = 0.5 + rng.uniform(-1e-4, 1e-4, 100)
    assert find_masses(dc, 0.05)[:100].all()


def test_set_aside_gives_them_one_code_and_leaves_the_others_theirs() -> None:
    labels = np.array([0, 1, 2, 1, 0, 2], np.int32)
    stage = Stage(np.arange(9, dtype=np.float32).reshape(3, 3), labels)
    still = np.array([True, False, False, True, False, False])
    apart = set_aside(stage, still)
    assert apart.labels.tolist() == [3, 1, 2, 3, 0, 2]
    assert apart.labels.dtype == np.int32
    assert apart.codebook[:3].tolist() == stage.codebook.tolist()
    assert apart.codebook[3].tolist() == [1.5, 2.5, 3.5]


def test_spared_masses_carry_nothing_and_without_masses_nothing_changes() -> None:
    dc = np.random.default_rng(2).normal(0.0, 1.0, (100, 3)).astype(np.float32)
    stages = (Stage(np.zeros((2, 3), np.float32), np.zeros(100, np.int32)),)
    assert spare_masses(dc, stages, 0.1) == (stages, None)
    dc[:20, 0] = 6.0
    spared, emphasis = spare_masses(dc, stages, 0.1, np.full(100, 0.5))
    assert emphasis is not None
    assert emphasis.tolist() == [0.0] * 20 + [0.5] * 80
    assert spared[0].labels.tolist() == [2] * 20 + [0] * 80


def test_a_scene_of_few_values_is_marked_all_over() -> None:
    assert not find_masses(np.full((100, 3), 0.25, np.float32), 0.02).any()
