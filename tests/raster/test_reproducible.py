"""The same bits whatever the number of threads, and from several callers at once."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from engine.raster import backward, draw, prepare_view, render, sh_colors
from tests.raster.scenes import camera, random_model
from tests.threads import with_one_and_two_threads

MODEL = random_model(5000, 70, 16)
VIEW = camera(301, 203, 250.0)
COTANGENT = np.random.default_rng(0).normal(size=(203, 301, 3)).astype(np.float32)


def everything() -> list[np.ndarray]:
    view = prepare_view(MODEL, VIEW)
    colors = sh_colors(MODEL.sh, MODEL.means, VIEW.position)
    g = backward(draw(MODEL, VIEW, 0.2), COTANGENT, COTANGENT[..., 0])
    return [
        view.visible,
        view.geometry.ids,
        colors,
        *view.render(colors),
        view.backward_colors(COTANGENT),
        *view.weights(),
        render(MODEL, VIEW),
        g.means,
        g.quats,
        g.log_scales,
        g.opacity_logits,
        g.sh,
        g.viewmat,
        g.K,
    ]


def test_any_number_of_threads() -> None:
    for one, many in zip(*with_one_and_two_threads(everything), strict=True):
        np.testing.assert_array_equal(one, many)


def test_callers_at_the_same_time() -> None:
    alone = everything()
    with ThreadPoolExecutor(3) as pool:
        together = list(pool.map(lambda _: everything(), range(6)))
    for result in together:
        for one, other in zip(alone, result, strict=True):
            np.testing.assert_array_equal(one, other)
