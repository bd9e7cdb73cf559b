"""Where curves break: known answers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from engine.lab.evaluate.stability.stability_curves import breaking_point, first_below, strength_at
from engine.lab.evaluate.stability.sweeps import all_sweeps, branches, thinned
from engine.lab.sim.attacks import IMAGE_ATTACKS, MODEL_ATTACKS


def test_a_line_is_crossed_between_its_points() -> None:
    assert first_below([1.0, 1.0, 0.5, 0.0], 0.75) == pytest.approx(1.5)
    assert first_below([0.2, 1.0], 0.75) == 0.0
    assert first_below([1.0, 0.8], 0.75) == math.inf


def test_strengths_between_those_tried() -> None:
    assert strength_at((0.01, 0.1, 1.0), 1.5) == pytest.approx(10**-0.5)
    assert strength_at((0.2, 0.4, 0.6), 0.5) == pytest.approx(0.3)
    assert strength_at((-0.1, -0.3), 0.5) == pytest.approx(-0.2)
    assert strength_at((0.1, 1.0), math.inf) is None
    assert strength_at(("splat", "sog"), 0.5) is None
    assert strength_at((10.0, 1.0), 0.0) == pytest.approx(10.0)


def test_intervals_span_the_trials() -> None:
    early, late = [1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 1.0, 0.0]
    broken = breaking_point(np.array([early, late]), 0.5)
    assert broken.low == pytest.approx(0.5)
    assert broken.high == pytest.approx(2.5)
    assert broken.low <= broken.step <= broken.high
    assert broken.lost
    never = breaking_point(np.ones((3, 4)), 0.5)
    assert not never.lost
    assert never.low == math.inf
    sometimes = breaking_point(np.array([early, [1.0] * 4, [1.0] * 4]), 0.5)
    assert sometimes.high == math.inf


def test_two_sided_grids_become_two_sweeps() -> None:
    assert branches((0.95, 1.05, 0.5, 2.0)) == {"down": (0.95, 0.5), "up": (1.05, 2.0)}
    assert branches((-0.1, 0.1, -0.3, 0.3)) == {"down": (-0.1, -0.3), "up": (0.1, 0.3)}
    assert branches((95, 50, 10)) == {"": (95, 50, 10)}
    assert branches(("a", "b")) == {"": ("a", "b")}
    assert thinned((1, 2, 3, 4, 5, 6, 7, 8, 9)) == (1, 3, 5, 7, 9)
    assert len(thinned(tuple("abcdefgh"))) == 8


def test_every_attack_and_reading_is_swept() -> None:
    sweeps = all_sweeps()
    names = [sweep.name for sweep in sweeps]
    assert len(set(names)) == len(names)
    attacks = {**MODEL_ATTACKS, **IMAGE_ATTACKS}
    wanted = {
        (name, reading.label) for name, attack in attacks.items() for reading in attack.readings if name != "transplant"
    }
    assert {(sweep.attack, sweep.reading) for sweep in sweeps} == wanted
