"""Compile every kernel before somebody waits for a picture."""

from collections.abc import Callable

import numpy as np

from engine.model import Camera, Float32, GaussianModel, look_at
from engine.raster.gradients import backward, draw
from engine.raster.pictures import render, render_depth
from engine.raster.settings import RasterSettings
from engine.raster.spherical_harmonics import sh_colors, sh_colors_backward
from engine.raster.view import View, prepare_view

__all__ = ["warm_up"]


def warm_up(progress: Callable[[float], None] | None = None) -> None:
    """Compile all kernels (about 20 s once a machine) or load them from numba's disk cache (well under 1 s).

    `progress` is called with the fraction done, 0 to 1.
    """
    model, camera = _scene()
    view = prepare_view(model, camera)
    colors = np.zeros((len(model), 1), dtype=np.float32)
    rendering = draw(model, camera)

    def discs() -> View:
        return prepare_view(model, camera, RasterSettings(kernel="disc"))

    steps: list[Callable[[], object]] = [
        lambda: render(model, camera),
        lambda: render_depth(model, camera),
        lambda: view.render(colors),
        lambda: view.backward_colors(rendering.image[..., :1]),
        lambda: view.backward_colors(rendering.image),
        view.weights,
        lambda: sh_colors_backward(sh_colors(model.sh, model.means, np.zeros(3)), model.sh, model.means, np.ones(3)),
        lambda: backward(rendering, rendering.image),
        lambda: discs().render(colors),
        lambda: discs().render(rendering.colors),
        lambda: discs().backward_colors(rendering.image[..., :1]),
        lambda: discs().backward_colors(rendering.image),
        lambda: discs().weights(),
    ]
    for done, step in enumerate(steps):
        if progress is not None:
            progress((done + 1) / (len(steps) + 1))
        step()
    if progress is not None:
        progress(1.0)


def _scene() -> tuple[GaussianModel, Camera]:
    """16 Gaussians in front of a camera of 16 x 16 pixels."""
    rng = np.random.default_rng(0)

    def random(scale: float, *shape: int) -> Float32:
        return rng.normal(0.0, scale, shape).astype(np.float32)

    model = GaussianModel(
        random(0.5, 16, 3), random(0.1, 16, 3) - 2, random(1.0, 16, 4), random(1.0, 16), random(0.3, 16, 4, 3)
    )
    return model, look_at((0.0, 0.0, -3.0), (0.0, 0.0, 0.0), (0.0, -1.0, 0.0), 16.0, 16, 16)
