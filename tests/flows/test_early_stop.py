"""The paper's early stop from a model alone: whose weights it takes, and what a picture then shows."""

from __future__ import annotations

import numpy as np

from engine.compress.impact import frequency_impact, measure_impact
from engine.flows.views.camera_rig import make_rig
from engine.flows.views.config import CONFIG
from engine.flows.views.view_set import early_stop, look, render_early
from engine.raster import render
from tests.watermark.ball import ball_model


def test_weights_are_the_ranks_of_w_freq() -> None:
    model = ball_model(300)
    size = CONFIG.frequency_size
    seen = look(model, make_rig(model, CONFIG.frequency_views, size, size), lambda _: None)
    value = frequency_impact(model, measure_impact(model, seen.views, seen.images))
    early = early_stop(model, 1.2)
    assert early.tau == 1.2
    assert (early.weights.min(), early.weights.max()) == (np.float32(1 / 300), 1.0)
    np.testing.assert_array_equal(np.argsort(early.weights), np.argsort(value, kind="stable"))


def test_a_larger_tau_shows_more_of_what_lies_behind() -> None:
    """Down to the whole picture."""
    model = ball_model(3_000)
    camera = make_rig(model, 1, 96, 96)[0]
    whole = render(model, camera)
    off = []
    for tau in (0.3, 0.95, 2.0, 1e6):
        early = early_stop(model, tau)
        off.append(float(np.abs(render_early(model, camera, early) - whole).mean()))
    assert off[0] > off[1] > off[2] > off[3] == 0.0
