"""How long an embedding takes, stage by stage, and how much memory it needs (`mark3dgs bench embed`).

Contract: every scene runs in a process of its own, so that its peak memory is its own; one run warms up
(kernels, file cache) and is thrown away, then come the timed ones; medians are reported, extremes beside.
"""

import statistics
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

__all__ = ["bench_embed", "in_own_process", "spread", "stage_medians"]

T = TypeVar("T")


def in_own_process(function: Callable[..., T], *arguments: Any) -> T:
    """Result of a module-level function run in a fresh process."""
    with ProcessPoolExecutor(max_workers=1, mp_context=get_context("spawn")) as pool:
        return pool.submit(function, *arguments).result()


def spread(seconds: Sequence[float], name: str = "seconds") -> dict[str, float]:
    """Median and extremes of repeated timings."""
    return {name: statistics.median(seconds), f"{name}_least": min(seconds), f"{name}_most": max(seconds)}


def stage_medians(runs: Sequence[dict[str, float]]) -> dict[str, float]:
    """Median of each stage over runs."""
    return {stage: statistics.median(run[stage] for run in runs) for stage in runs[0]}


def bench_embed(
    scenes: Sequence[str | Path],
    profile: str = "fast",
    repeats: int = 3,
    seed: int = 0,
    advance: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Time embeddings of 32 bits.

    Parameters
    ----------
    scenes : sequence of path
        Model files.
    repeats : int
        Timed runs, after one that is not.
    seed : int
        Of the measurement's own key.
    advance : callable, optional
        Called with the fraction done.

    Returns
    -------
    dict
        `profile`, `repeats` and `rows`, one a scene: gaussians, sh_degree, seconds (median, least, most),
        read_seconds, seconds_by_stage, peak_memory_mb, psnr_worst_view, ssim_worst_view, predicted_z_per_bit.
    """
    rows = []
    for number, scene in enumerate(scenes):
        rows.append(in_own_process(_measure, str(scene), profile, repeats, seed))
        if advance:
            advance((number + 1) / len(scenes))
    return {"profile": profile, "repeats": repeats, "rows": rows}


def _measure(path: str, profile: str, repeats: int, seed: int) -> dict[str, Any]:
    from engine.evaluate.marked_scene import bench_key
    from engine.formats import read_model
    from engine.numerics.machine import peak_memory_mb
    from engine.pipeline.embedding import embed
    from engine.pipeline.profiles import profile as named_profile

    began = time.perf_counter()
    loaded = read_model(path)
    read_seconds = time.perf_counter() - began
    key, config = bench_key(seed), named_profile(profile)
    reports = []
    for _ in range(repeats + 1):
        reports.append(embed(loaded.model, key, original_sha256=loaded.sha256, config=config).report)
    timed = reports[1:]
    last = timed[-1]
    return {
        "scene": Path(path).name,
        "gaussians": len(loaded.model),
        "sh_degree": loaded.model.sh_degree,
        **spread([report["seconds"] for report in timed]),
        "first_seconds": reports[0]["seconds"],
        "read_seconds": read_seconds,
        "seconds_by_stage": stage_medians([report["seconds_by_stage"] for report in timed]),
        "peak_memory_mb": peak_memory_mb(),
        **{name: last[name] for name in ("psnr_worst_view", "ssim_worst_view", "predicted_z_per_bit")},
    }
