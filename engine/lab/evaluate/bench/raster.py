"""How long pictures and gradients take: milliseconds, the median of `repeats` runs after one that is not timed."""

import math
from collections.abc import Callable

import numpy as np

from engine.flows.warmup.kernel_warmup import warm_up
from engine.lab.evaluate.bench.timing import median_ms
from engine.lab.evaluate.study import Row
from engine.lab.raster.sh_gradients import sh_colors_backward
from engine.model import Camera, GaussianModel, look_at
from engine.raster import Gradients, backward, draw, render


def bench_camera(model: GaussianModel, width: int, height: int) -> Camera:
    """A view of a scene's dense part: off-centre, slightly from above, 960 pixels of focal length at 1297
    wide."""
    solid = model.opacities > 0.3
    points = model.means[solid] if solid.any() else model.means
    centre = np.median(points, axis=0)
    radius = float(np.quantile(np.linalg.norm(points - centre, axis=1), 0.8)) or 1.0
    eye = centre + 2.2 * radius * np.array([math.cos(0.3), -0.35, math.sin(0.3)])
    return look_at(eye, centre, (0.0, -1.0, 0.0), 960.0 * width / 1297.0, width, height)


def bench_raster(model: GaussianModel, width: int, height: int, repeats: int) -> Row:
    """Time the rasterizer on one model and the view of `bench_camera`, in pixels.

    `forward_ms` (render: projection to image), `backward_color_ms` (image cotangent to SH gradient, geometry cached),
    `backward_ms` (every parameter and the camera; not for discs), and `pairs` of tile and Gaussian.
    """
    warm_up("everything")
    camera = bench_camera(model, width, height)
    rendering = draw(model, camera)
    view, colors = rendering.view, rendering.colors
    cotangent = np.random.default_rng(0).normal(size=rendering.image.shape).astype(np.float32)
    sh_gradient, gradients = np.empty_like(model.sh), Gradients.empty(model)

    def backward_color() -> None:
        to_sh = view.backward_colors(cotangent)
        sh_colors_backward(to_sh, model.sh, model.means, camera.position, colors=colors, out=sh_gradient)

    stages: dict[str, Callable[[], object]] = {
        "forward_ms": lambda: render(model, camera),
        "backward_color_ms": backward_color,
    }
    if len(view.geometry.discs) == 0:
        stages["backward_ms"] = lambda: backward(rendering, cotangent, out=gradients)
    return {name: median_ms(stage, repeats) for name, stage in stages.items()} | {"pairs": len(view.geometry.ids)}
