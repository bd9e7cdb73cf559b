"""Cells of the cost study: one size, in a process of its own, so that its peak memory is its own."""

import statistics
import time
from typing import Any

from engine.evaluate.bench.timing import in_own_process, stage_medians
from engine.evaluate.study import Row

__all__ = ["measure_formats", "measure_roofline", "measure_size"]

RASTER_SIZE = (1297, 840)
FLOPS_PER_FRAGMENT = 32
"""Of the forward kernel with three channels, a fused multiply-add counted as two: offsets 2, quadratic form 8, 2^q 13
(range reduction 3, polynomial of degree 5), weight and transmittance 3, colours 6."""
BYTES_PER_PAIR = 48
"""Read once a Gaussian and tile: its number (4), record (32) and colour (12)."""
BYTES_PER_PIXEL = 16
"""Written: colour and alpha."""


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
    """Embed, verify and draw at one size.

    Parameters
    ----------
    scene : str
        Path of a model.
    axis : str
        What grows, for the report; `size` is its value.
    gaussians : int, optional
        Thin or replicate the scene to this many.
    views, view_size, landmarks : int
        Of the embedding (profile fast otherwise).
    repeats : int
        Embeddings, after one small one that warms up.
    raster_size : (int, int), optional
        Of the picture that is drawn, pixels; 1297x840.
    picture_size : int
        Side of the picture that is verified, pixels.
    apart : bool
        In a process of its own; without, `peak_memory_mb` is that of all that went before, too.
    """
    width, height = raster_size or RASTER_SIZE  # a list where the arguments were stored
    chosen = (scene, gaussians, views, view_size, landmarks, repeats, (width, height), picture_size, seed)
    found = in_own_process(_size, *chosen) if apart else _size(*chosen)
    return [{"axis": axis, "size": size, **found}]


def _size(
    scene: str,
    gaussians: int | None,
    views: int,
    view_size: int,
    landmarks: int,
    repeats: int,
    raster_size: tuple[int, int],
    picture_size: int,
    seed: int,
) -> Row:
    from engine.evaluate.bench.attacks import to_8_bit
    from engine.evaluate.bench.raster import bench_raster
    from engine.evaluate.cost.scenes import sized
    from engine.evaluate.marked_scene import bench_key
    from engine.formats import read_model
    from engine.numerics.machine import load_per_core, peak_memory_mb
    from engine.pipeline.embedding import embed
    from engine.pipeline.profiles import EmbedConfig, profile
    from engine.pipeline.rigs import make_rig
    from engine.pipeline.sealing import open_record
    from engine.pipeline.verification import VerifyConfig, verify_images, verify_model
    from engine.raster import render

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
    opened = open_record(made.record.to_bytes(key), key)
    camera = make_rig(model, 1, picture_size, picture_size)[0]
    picture = to_8_bit(render(made.model, camera))
    whole = [verify_model(made.model, opened, VerifyConfig(route="model")) for _ in range(repeats)]
    seen = [verify_images([picture], opened, VerifyConfig(), cameras=[camera]) for _ in range(repeats)]
    raster = bench_raster(made.model, *raster_size, repeats=3 if repeats == 1 else 7)
    return {
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


def measure_formats(scene: str, formats: list[str]) -> list[Row]:
    """Bytes a Gaussian of the marked model in each format, and seconds to write and read it."""
    import tempfile
    from pathlib import Path

    from engine.evaluate.marked_scene import mark_scene
    from engine.formats import read_model, write_model
    from engine.pipeline.profiles import profile

    subject = mark_scene(scene, profile("fast", views=4, view_size=256, landmark_views=0, psnr_db=40.0), bits=16)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for name in formats:
            path = Path(folder) / f"model.{name}"
            began = time.perf_counter()
            size = write_model(subject.marked, path, name)
            written = time.perf_counter()
            read_model(path)
            rows.append(
                {
                    "format": name,
                    "bytes": size,
                    "gaussians": len(subject.marked),
                    "sh_degree": subject.marked.sh_degree,
                    "write_s": written - began,
                    "read_s": time.perf_counter() - written,
                }
            )
    return rows


def measure_roofline(scene: str, quick: bool) -> list[Row]:
    """The forward kernel against what the machine can do."""
    from engine.evaluate.bench.raster import bench_raster
    from engine.evaluate.cost.peaks import peak_bandwidth, peak_flops
    from engine.formats import read_model

    width, height = (320, 200) if quick else RASTER_SIZE
    raster = bench_raster(read_model(scene).model, width, height, repeats=3 if quick else 9)
    bandwidth = peak_bandwidth(1 << 21 if quick else 1 << 25)
    flops = peak_flops(1 << 17 if quick else 1 << 22)
    return [_roofline(raster, bandwidth, flops)]


def _roofline(raster: dict[str, Any], bandwidth: float, flops: float) -> Row:
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
