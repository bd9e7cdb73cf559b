"""Cells of the cost study: scenes of any size, each in a process of its own, so that its peak memory is its own.

What this machine can do at most is measured by McCalpin's triad (STREAM, 1995), bytes a second from memory, and by
independent chains of fused multiply-adds in registers; both on the threads the rasterizer uses.
"""

import math
import statistics
import tempfile
import time

# mypy: allow-untyped-defs, allow-untyped-calls
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import EmbedConfig, profile
from engine.flows.records.opened_record import open_record
from engine.flows.verify.search import VerifyConfig, verify_images, verify_model
from engine.flows.views.camera_rig import make_rig, measure_extent
from engine.formats import read_model, write_model
from engine.kernels.jit import parallel_kernel, share_of
from engine.kernels.thread_crew import thread_count
from engine.lab.evaluate.bench.attacks import to_8_bit
from engine.lab.evaluate.bench.raster import bench_raster
from engine.lab.evaluate.bench.timing import in_own_process, seconds_of, stage_medians
from engine.lab.evaluate.machine import load_per_core, peak_memory_mb
from engine.lab.evaluate.marked_scene import bench_key, mark_scene
from engine.lab.evaluate.study import Row
from engine.model import GaussianModel
from engine.numerics.similarity import transform_model
from engine.raster import render
from engine.raster.lane_ir import LANES
from engine.raster.lane_memory import aligned, load, store
from engine.raster.lanes import fma
from engine.watermark.rates import MADE_FIRST

CHAINS = 12
"""Chains a thread keeps in flight: more than latency (4 cycles) times ports (2)."""


@parallel_kernel
def _triad(a, b, c, scale, call):
    for i in share_of(a.shape[0], call):
        a[i] = b[i] + scale * c[i]


@parallel_kernel
def _multiply_add(out, rounds, call):
    for worker in share_of(out.shape[0], call):
        own = out[worker]
        times, plus = load(own, 12 * 16), load(own, 13 * 16)
        x0, x1, x2, x3 = load(own, 0), load(own, 16), load(own, 32), load(own, 48)
        x4, x5, x6, x7 = load(own, 64), load(own, 80), load(own, 96), load(own, 112)
        x8, x9, x10, x11 = load(own, 128), load(own, 144), load(own, 160), load(own, 176)
        for _ in range(rounds):
            x0, x1, x2 = fma(x0, times, plus), fma(x1, times, plus), fma(x2, times, plus)
            x3, x4, x5 = fma(x3, times, plus), fma(x4, times, plus), fma(x5, times, plus)
            x6, x7, x8 = fma(x6, times, plus), fma(x7, times, plus), fma(x8, times, plus)
            x9, x10, x11 = fma(x9, times, plus), fma(x10, times, plus), fma(x11, times, plus)
        store(own, 0, x0 + x1 + x2 + x3 + x4 + x5 + x6 + x7 + x8 + x9 + x10 + x11)


def peak_bandwidth(numbers: int = 1 << 25, repeats: int = 5) -> float:
    """Bytes a second of a = b + s c over three float32 arrays of `numbers`, best of `repeats`; 12 bytes a number."""
    a, b, c = (np.full(numbers, value, dtype=np.float32) for value in (0.0, 1.0, 2.0))
    return 12.0 * numbers / _least_seconds(lambda: _triad(a, b, c, np.float32(3.0)), repeats)


def peak_flops(rounds: int = 1 << 22, repeats: int = 5) -> float:
    """Single-precision operations a second of fused multiply-adds on sixteen lanes, each counted as two."""
    out = aligned((thread_count(), (CHAINS + 2) * LANES))
    out[:] = 0.5
    operations = 2.0 * LANES * CHAINS * rounds * len(out)
    return operations / _least_seconds(lambda: _multiply_add(out, rounds), repeats)


def _least_seconds(work: Callable[[], object], repeats: int) -> float:
    """Of several runs after one that compiles: other programs can only make it longer."""
    times = []
    for _ in range(repeats + 1):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return min(times[1:])


RASTER_SIZE = (1297, 840)
FLOPS_PER_FRAGMENT = 32
"""Of the forward kernel with three channels, a fused multiply-add counted as two: offsets 2, quadratic form 8, 2^q 13
(range reduction 3, polynomial of degree 5), weight and transmittance 3, colours 6."""
BYTES_PER_PAIR = 48
"""Read once a Gaussian and tile: its number (4), record (32) and colour (12)."""
BYTES_PER_PIXEL = 16
"""Written: colour and alpha."""
SPACING = 2.0
"""Between copies, in robust radii: neighbours touch and hide one another in part, as houses of a town do."""


def measure_size(
    scene: str,
    axis: str,
    size: int,
    seed: int,
    *,
    gaussians: int | None = None,
    views: int = 6,
    view_size: int = 800,
    landmarks: int = 48,
    repeats: int = 3,
    raster_size: tuple[int, int] | None = None,
    picture_size: int = 800,
    apart: bool = True,
) -> list[Row]:
    """Embed, verify and draw at one size of what grows along the axis, `repeats` times after one that warms up.

    The scene is thinned or replicated to so many Gaussians where a number is given; views and landmarks are of the
    embedding (profile fast otherwise), `raster_size` (1297x840 where not given) of the picture that is drawn,
    `picture_size` the side of the one that is verified, all in pixels. Without a process of its own (`apart`),
    `peak_memory_mb` is that of all that went before, too.
    """
    if apart:
        return in_own_process(partial(measure_size, **{**locals(), "apart": False}))
    loaded = read_model(scene)
    model = loaded.model if gaussians is None else sized(loaded.model, gaussians, seed)
    key = bench_key(seed)
    small = EmbedConfig(views=2, view_size=128, landmark_views=2, psnr_db=40.0)
    embed(sized(loaded.model, min(5_000, len(loaded.model))), key, original_sha256=loaded.sha256, bits=16, config=small)
    model_memory = peak_memory_mb()
    # As strong as it takes for the smallest size to carry the bits; that costs the same time.
    config = profile("fast", views=views, view_size=view_size, landmark_views=landmarks, psnr_db=35.0, ssim=0.95)
    runs = []
    for _ in range(repeats):
        made = embed(model, key, original_sha256=loaded.sha256, bits=16, config=config)
        runs.append(made.report["seconds_by_stage"])
    memory = peak_memory_mb()
    opened = open_record(made.record.to_bytes(key), key, MADE_FIRST)
    camera = make_rig(model, 1, picture_size, picture_size)[0]
    picture = to_8_bit(render(made.model, camera))
    whole = [verify_model(made.model, opened, VerifyConfig(route="model")) for _ in range(repeats)]
    seen = [verify_images([picture], opened, VerifyConfig(), cameras=[camera]) for _ in range(repeats)]
    raster = bench_raster(made.model, *(raster_size or RASTER_SIZE), repeats=3 if repeats == 1 else 7)
    row = {
        "axis": axis,
        "size": size,
        "gaussians": len(model),
        "views": views,
        "view_size": view_size,
        "repeats": repeats,
        "busy": load_per_core(),
        "stages": stage_medians(runs),
        "verify_model_s": statistics.median(run.seconds for run in whole),
        "verify_picture_s": statistics.median(run.seconds for run in seen),
        "z_model": whole[0].claim.z,
        "z_picture": seen[0].claim.z,
        "forward_ms": raster["forward_ms"],
        "backward_color_ms": raster["backward_color_ms"],
        "backward_ms": raster.get("backward_ms"),
        "pairs": raster["pairs"],
        "peak_memory_mb": memory,
        "memory_before_mb": model_memory,
        "peak_memory_all_mb": peak_memory_mb(),
    }
    return [row]


def measure_formats(scene: str, formats: list[str]) -> list[Row]:
    """Bytes a Gaussian of the marked model in each format, and seconds to write and read it."""
    config = profile("fast", views=4, view_size=256, landmark_views=0, psnr_db=40.0)
    marked = mark_scene(scene, config, bits=16).marked
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for name in formats:
            path = Path(folder) / f"model.{name}"
            began = time.perf_counter()
            size = write_model(marked, path, name)
            row = {"format": name, "bytes": size, "gaussians": len(marked), "sh_degree": marked.sh_degree}
            row["write_s"] = time.perf_counter() - began
            rows.append({**row, "read_s": seconds_of(partial(read_model, path))})
    return rows


def measure_roofline(scene: str, quick: bool) -> list[Row]:
    """The forward kernel against what the machine can do."""
    width, height = (320, 200) if quick else RASTER_SIZE
    raster = bench_raster(read_model(scene).model, width, height, repeats=3 if quick else 9)
    return [_roofline(raster, peak_bandwidth(1 << 21 if quick else 1 << 25), peak_flops(1 << 17 if quick else 1 << 22))]


def _roofline(raster: Row, bandwidth: float, flops: float) -> Row:
    seconds = raster["blend_ms"] / 1000.0
    fragments = raster["fragments_per_second"] * seconds
    operations = FLOPS_PER_FRAGMENT * fragments
    moved = BYTES_PER_PAIR * raster["pairs"] + BYTES_PER_PIXEL * raster["width"] * raster["height"]
    intensity = operations / moved
    attainable = min(flops, intensity * bandwidth)
    return {
        "gaussians": raster["gaussians"],
        "pairs": raster["pairs"],
        "fragments": fragments,
        "blend_ms": raster["blend_ms"],
        "flops_per_byte": intensity,
        "achieved_flops": operations / seconds,
        "attainable_flops": attainable,
        "peak_flops": flops,
        "peak_bytes": bandwidth,
        "fraction": operations / seconds / attainable,
        "threads": raster["threads"],
    }


def sized(model: GaussianModel, count: int, seed: int = 0) -> GaussianModel:
    """A scene of exactly `count` Gaussians made of a real one; needs memory for itself and one copy of the model.

    Fewer than the model has: a random choice of them. More: copies on a square grid, each turned about the up axis by
    an angle of its own, the last one thinned.
    """
    if count < 1:
        raise ValueError(f"a scene needs a Gaussian, got {count}")
    rng = np.random.default_rng(seed)
    copies = math.ceil(count / len(model))
    if copies == 1:
        return model.take(np.sort(rng.choice(len(model), count, replace=False)))
    extent = measure_extent(model)
    side = math.ceil(math.sqrt(copies))
    made = model.take(np.arange(count) % len(model))
    for copy in range(copies):
        first, last = copy * len(model), min((copy + 1) * len(model), count)
        piece = model if last - first == len(model) else sized(model, last - first, seed)
        angle = rng.uniform(0.0, 2.0 * np.pi)
        turn = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
        step = SPACING * extent.radius * np.array([copy % side, 0.0, copy // side])
        piece = transform_model(piece, 1.0, turn, extent.center + step - turn @ extent.center)
        for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
            getattr(made, name)[first:last] = getattr(piece, name)
    return made
