"""Cells of the cost study: scenes of any size, each in a process of its own, so that its peak memory is its own."""

import math
import statistics
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np

from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import EmbedConfig, profile
from engine.flows.records.opened_record import open_record
from engine.flows.verify.search import VerifyConfig, verify_images, verify_model
from engine.flows.views.camera_rig import make_rig, measure_extent
from engine.formats import read_model, write_model
from engine.lab.evaluate.bench.attacks import to_8_bit
from engine.lab.evaluate.bench.raster import bench_raster
from engine.lab.evaluate.bench.timing import in_own_process, seconds_of, stage_medians
from engine.lab.evaluate.machine import load_per_core, peak_memory_mb
from engine.lab.evaluate.marked_scene import bench_key, mark_scene
from engine.lab.evaluate.study import Row
from engine.model import GaussianModel
from engine.numerics.similarity import transform_model
from engine.raster import render
from engine.watermark.rates import MADE_FIRST

RASTER_SIZE = (1297, 840)
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
