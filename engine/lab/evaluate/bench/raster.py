"""How long pictures and gradients take.

Contract: every figure is the median of `repeats` runs after one that is not timed, in milliseconds, on the
threads numba uses; memory for results is reused where the interface allows. The yardstick is what one would
write first: a compiled loop over pixels that blends the same exact tile lists, measured in the same
process.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from engine.flows.warmup.kernel_warmup import warm_up
from engine.formats import read_model
from engine.kernels.jit import inlined, parallel_kernel, share_of
from engine.kernels.thread_crew import thread_count
from engine.lab.evaluate.bench.timing import median_ms
from engine.lab.evaluate.machine import machine_info, peak_memory_mb
from engine.lab.evaluate.study import Row
from engine.lab.raster.sh_gradients import sh_colors_backward
from engine.model import Camera, Float32, GaussianModel, look_at
from engine.raster import Gradients, View, backward, draw, prepare_view, render, sh_colors
from engine.raster.disc_projection import LOW_PASS
from engine.raster.projection import RECORD
from engine.raster.settings import TILE
from engine.raster.view import blend_colors
from engine.raster.workspace import borrow_workspace


def bench_camera(model: GaussianModel, width: int, height: int) -> Camera:
    """A view of a scene's dense part: off-centre, slightly from above, 960 pixels of focal length at 1297
    wide."""
    solid = model.opacities > 0.3
    points = model.means[solid] if solid.any() else model.means
    centre = np.median(points, axis=0)
    radius = float(np.quantile(np.linalg.norm(points - centre, axis=1), 0.8)) or 1.0
    eye = centre + 2.2 * radius * np.array([math.cos(0.3), -0.35, math.sin(0.3)])
    return look_at(eye, centre, (0.0, -1.0, 0.0), 960.0 * width / 1297.0, width, height)


@inlined
def _gaussian(records, o, x, y):
    dx, dy = x - records[o], y - records[o + 1]
    return records[o + 2] * dx * dx + records[o + 3] * dx * dy + records[o + 4] * dy * dy + records[o + 5]


@inlined
def _disc(discs, o, x, y):
    dx, dy = x - discs[o], y - discs[o + 1]
    p0, p1 = discs[o + 2] * dx, discs[o + 3] * dx + discs[o + 4] * dy
    g = np.float32(1.0) - discs[o + 5] * p0 - discs[o + 6] * p1
    rho = np.float32(LOW_PASS) * (dx * dx + dy * dy)
    if g > np.float32(0.0):
        rho = min(rho, (p0 * p0 + p1 * p1) / (g * g))
    return discs[o + 7] - rho * np.float32(0.5 * math.log2(math.e))


@parallel_kernel
def _naive(records, discs, colors, ids, starts, width, height, tiles_x, log2_skip, clamp, stop, image, call):
    """Pixel by pixel, list entry by list entry, no vectors."""
    for y in share_of(height, call):
        for x in range(width):
            tile = (y // TILE) * tiles_x + x // TILE
            transmittance = np.float32(1.0)
            red, green, blue = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for k in range(starts[tile], starts[tile + 1]):
                i = np.int64(ids[k])
                px, py = np.float32(x) + np.float32(0.5), np.float32(y) + np.float32(0.5)
                if discs.shape[0] == 0:
                    q = _gaussian(records, i * RECORD, px, py)
                else:
                    q = _disc(discs, i * RECORD, px, py)
                if q < log2_skip:
                    continue
                weight = min(np.float32(2.0) ** q, clamp) * transmittance
                if transmittance - weight <= stop:
                    break
                red += weight * colors[i, 0]
                green += weight * colors[i, 1]
                blue += weight * colors[i, 2]
                transmittance -= weight
            image[y, x, 0] = red
            image[y, x, 1] = green
            image[y, x, 2] = blue


def naive_forward(view: View, colors: Float32) -> Float32:
    """The image by the plain loop, black background."""
    geometry, camera = view.geometry, view.camera
    image = np.empty((camera.height, camera.width, 3), dtype=np.float32)
    shown = (geometry.records, geometry.discs, colors, geometry.ids, geometry.starts)
    _naive(*shown, camera.width, camera.height, geometry.tiles_x, *geometry.limits, image)
    return image


def measure_raster(scene: str, seed: int, repeats: int, size: tuple[int, int]) -> list[Row]:
    """`bench_raster` of a scene; nothing is drawn by lot."""
    return [{"scene": Path(scene).name, **bench_raster(read_model(scene).model, *size, repeats)}]


def bench_raster(model: GaussianModel, width: int = 1297, height: int = 840, repeats: int = 9) -> Row:
    """Time the rasterizer on one model and the view of `bench_camera`, in pixels.

    JSON-ready: `forward_ms` (render: projection to image), `prepare_ms` (a view that is kept), `blend_ms` (the raster
    stage alone), `backward_color_ms` (image cotangent to SH gradient, geometry cached), `backward_ms` (every parameter
    and the camera; not for discs), `cached_iteration_ms` (SH, image, SH gradient, geometry cached), `naive_forward_ms`
    (raster stage of the plain loop) and `speedup_over_naive` (that over blend_ms); `fragments_per_second` (pixel and
    Gaussian, evaluated, blend_ms), counts, machine.
    """
    warm_up("everything")
    camera = bench_camera(model, width, height)
    position = camera.position
    rendering = draw(model, camera)
    view, colors = rendering.view, rendering.colors
    cotangent = np.random.default_rng(0).normal(size=rendering.image.shape).astype(np.float32)
    sh_gradient, gradients = np.empty_like(model.sh), Gradients.empty(model)

    def backward_color() -> None:
        to_sh = view.backward_colors(cotangent)
        sh_colors_backward(to_sh, model.sh, model.means, position, colors=colors, out=sh_gradient)

    def cached_iteration() -> None:
        shown = sh_colors(model.sh, model.means, position)
        image, _ = view.render(shown)
        to_sh = view.backward_colors(image - cotangent)
        sh_colors_backward(to_sh, model.sh, model.means, position, colors=shown, out=sh_gradient)

    stages: dict[str, Callable[[], object]] = {
        "forward_ms": lambda: render(model, camera),
        "prepare_ms": lambda: prepare_view(model, camera),
        "blend_ms": lambda: view.render(colors),
        "backward_color_ms": backward_color,
        "cached_iteration_ms": cached_iteration,
        "naive_forward_ms": lambda: naive_forward(view, colors),
    }
    if len(view.geometry.discs) == 0:
        stages["backward_ms"] = lambda: backward(rendering, cotangent, out=gradients)
    times = {name: median_ms(stage, repeats) for name, stage in stages.items()}
    with borrow_workspace() as work:
        _, _, fragments = blend_colors(view.geometry, colors, np.zeros(3, np.float32), work)
    machine = machine_info()
    return {
        **times,
        "speedup_over_naive": round(times["naive_forward_ms"] / times["blend_ms"], 1),
        "gaussians": len(model),
        "visible": len(view.visible),
        "pairs": len(view.geometry.ids),
        "width": width,
        "height": height,
        "fragments_per_second": fragments / (times["blend_ms"] / 1000.0),
        "threads": thread_count(),
        "repeats": repeats,
        "peak_memory_mb": round(peak_memory_mb(), 1),
        "machine": machine,
        "versions": machine["packages"],
    }
