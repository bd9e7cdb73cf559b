"""Looks changed on purpose: baked, smoothed, painted anew."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from engine.errors import InputError
from engine.flows.views.camera_rig import make_rig
from engine.lab.sim.attacks import model_attack
from engine.model import SH_C0, GaussianModel
from engine.numerics.image_metrics import psnr
from engine.raster import render


def test_baked_colors_are_closer_to_the_views_than_plain_truncation(model: GaussianModel) -> None:
    tilted = model.sh.copy()
    tilted[:, 1:4] += 0.3  # a trend over the sphere, so that the mean over the views is not the DC
    tilted = model.with_(sh=tilted)
    rig = make_rig(tilted, 4, 96, 96)
    baked = model_attack("bake_colors").apply(tilted, 24, rng=1)
    cut = model_attack("drop_sh").apply(tilted, 0)
    assert baked.sh_degree == 0
    looks = [np.mean([psnr(render(tilted, c), render(m, c)) for c in rig]) for m in (baked, cut)]
    assert looks[0] > looks[1] + 0.5
    np.testing.assert_array_equal(baked.means, tilted.means)


def test_one_view_is_baked_as_it_was_seen(model: GaussianModel) -> None:
    """With a single view the baked model looks as the original does from there, and not from elsewhere."""
    camera = make_rig(model, 1, 256, 256, jitter=np.random.default_rng(6).random((1, 4)))[0]
    baked = model_attack("bake_colors").apply(model, 1, rng=6)
    assert psnr(render(model, camera), render(baked, camera)) > 50
    other = make_rig(model, 3, 256, 256)[2]
    assert psnr(render(model, other), render(baked, other)) < 45


def test_smoothing_takes_noise_off_and_leaves_edges(model: GaussianModel) -> None:
    side = model.means[:, 0] > 3.0
    flat = np.where(side[:, None], 1.5, -1.5) * np.ones(3)
    noisy = model.with_dc(flat + 0.1 * np.random.default_rng(0).standard_normal((500, 3)))
    out = model_attack("smooth_colors").apply(noisy, 16)
    assert np.abs(out.sh[:, 0] - flat).mean() < 0.5 * np.abs(noisy.sh[:, 0] - flat).mean()
    assert np.abs(out.sh[:, 0] - flat).max() < 0.5
    np.testing.assert_array_equal(out.sh[:, 1:], noisy.sh[:, 1:])
    with pytest.raises(InputError, match="whole number"):
        model_attack("smooth_colors").apply(noisy, 2.5)


def test_repainting_changes_the_said_share_in_connected_regions(model: GaussianModel) -> None:
    out = model_attack("repaint").apply(model, 0.3, rng=2)
    changed = np.abs(out.sh[:, 0] - model.sh[:, 0]).max(axis=1) > 1e-6
    assert changed.mean() == pytest.approx(0.3, abs=0.02)
    assert not out.sh[changed, 1:].any()
    np.testing.assert_array_equal(out.sh[~changed], model.sh[~changed])
    near = cKDTree(model.means).query(model.means, k=4)[1][:, 1:]
    assert changed[near[changed]].mean() > 0.6  # by chance it would be 0.3
    shown = 0.5 + SH_C0 * out.sh[changed, 0]
    assert shown.min() > -1e-6
    assert shown.max() < 1 + 1e-6
    np.testing.assert_array_equal(out.means, model.means)
