"""Compile every kernel before somebody waits for a picture."""

from collections.abc import Callable

import numpy as np

from engine.model import Camera, Float32, GaussianModel, look_at
from engine.raster.gradients import backward, draw
from engine.raster.rendering import render, render_depth
from engine.raster.settings import RasterSettings
from engine.raster.spherical_harmonics import sh_colors, sh_colors_backward
from engine.raster.view import View, prepare_view

__all__ = ["WARM_UPS", "warm_up"]


def warm_up(progress: Callable[[float], None] | None = None) -> None:
    """Compile all kernels (about 20 s of one core, once a machine) or load them from numba's disk cache (well under
    1 s).

    `progress` is called with the fraction done, 0 to 1.
    """
    for done, step in enumerate(WARM_UPS.values()):
        if progress is not None:
            progress((done + 1) / (len(WARM_UPS) + 1))
        step()
    if progress is not None:
        progress(1.0)


def _geometry() -> None:
    prepare_view(*_scene())


def _colors() -> None:
    model, _ = _scene()
    sh_colors_backward(sh_colors(model.sh, model.means, np.zeros(3)), model.sh, model.means, np.ones(3))


def _pictures() -> None:
    model, camera = _scene()
    render(model, camera)
    render_depth(model, camera)
    prepare_view(model, camera).render(_one_channel(model))


def _color_gradients() -> None:
    view = prepare_view(*_scene())
    _pull_back(view)


def _all_gradients() -> None:
    rendering = draw(*_scene())
    backward(rendering, rendering.image)


def _discs() -> None:
    model, camera = _scene()
    view = prepare_view(model, camera, RasterSettings(kernel="disc"))
    view.render(_one_channel(model))
    view.render(np.zeros((len(model), 3), dtype=np.float32))
    _pull_back(view)


WARM_UPS: dict[str, Callable[[], None]] = {
    "geometry": _geometry,
    "colors": _colors,
    "pictures": _pictures,
    "color gradients": _color_gradients,
    "all gradients": _all_gradients,
    "discs": _discs,
}
"""Each compiles some kernels; they may run in several processes, a kernel's types one after another."""


def _one_channel(model: GaussianModel) -> Float32:
    return np.zeros((len(model), 1), dtype=np.float32)


def _pull_back(view: View) -> None:
    for channels in (1, 3):
        view.backward_colors(np.zeros((view.camera.height, view.camera.width, channels), dtype=np.float32))
    view.weights()


def _scene() -> tuple[GaussianModel, Camera]:
    """16 Gaussians in front of a camera of 16 x 16 pixels."""
    rng = np.random.default_rng(0)

    def random(scale: float, *shape: int) -> Float32:
        return rng.normal(0.0, scale, shape).astype(np.float32)

    model = GaussianModel(
        random(0.5, 16, 3), random(0.1, 16, 3) - 2, random(1.0, 16, 4), random(1.0, 16), random(0.3, 16, 4, 3)
    )
    return model, look_at((0.0, 0.0, -3.0), (0.0, 0.0, 0.0), (0.0, -1.0, 0.0), 16.0, 16, 16)
