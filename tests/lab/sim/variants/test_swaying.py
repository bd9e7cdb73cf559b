from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.flows.views.camera_rig import make_rig
from engine.lab.sim.variants.synthetic import SwayingScene, set_in_motion
from engine.model import GaussianModel
from engine.numerics.image_metrics import psnr
from engine.raster import render
from engine.scenes.spacetime import SpacetimeModel


def test_the_foot_stands_and_the_top_sways(swaying: SwayingScene) -> None:
    moved = np.linalg.norm(swaying.at(0.2).means - swaying.at(0.8).means, axis=1)
    assert moved[swaying.height == 0].max() == 0.0
    assert np.median(moved[swaying.height > 0.9]) > 10 * np.median(moved[swaying.height < 0.1])


def test_parts_come_and_go(swaying: SwayingScene) -> None:
    there = np.stack([swaying.at(t).opacities > 0.5 * swaying.still.opacities for t in (0.0, 0.5, 1.0)])
    transient = swaying.window[:, 0] > -1
    assert 0.05 < transient.mean() < 0.6
    assert there[:, ~transient].all()
    assert 0.1 < there[:, transient].mean() < 0.9


def test_what_sways_turns_with_it(plant: GaussianModel) -> None:
    scene = set_in_motion(plant, swing=0.02, transient=0.0, seed=2)
    still, moved = scene.still, scene.at(0.3)
    change = np.abs(still.quats - moved.quats).max(axis=1)
    assert np.median(change[scene.height > 0.9]) > 1e-3
    assert change[scene.height == 0].max() < 1e-6


def test_a_fit_is_near_the_truth_but_not_the_truth(swaying: SwayingScene, clip: SpacetimeModel) -> None:
    camera = make_rig(swaying.still, 1, 192, 192)[0]
    fits, stills = [], []
    for time in (0.25, 0.6):
        truth = render(swaying.at(time), camera)
        fits.append(psnr(truth, render(clip.at(time), camera)))
        stills.append(psnr(truth, render(swaying.still, camera)))
    assert min(fits) > 22
    assert max(fits) < 60
    assert min(fits) > min(stills) + 3  # a model that stands still is much farther off


def test_ranges(plant: GaussianModel) -> None:
    with pytest.raises(InputError, match=r"transient must lie in 0\.\.1, got 0\.04 and 1\.5"):
        set_in_motion(plant, transient=1.5)
