"""How long embedding and verifying take, stage by stage, and how much memory an embedding needs.

Contract: every scene is marked and verified in a process of its own, so that its peak memory is its own; one run warms
up (kernels, file cache) and is thrown away, then come the timed ones; medians are reported, with extremes.
"""

import statistics
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

import numpy as np

from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import profile as named_profile
from engine.flows.verify.search import Verification, verify_images, verify_model
from engine.formats import read_model
from engine.kernels.allocation import keep_freed_memory
from engine.lab.evaluate.bench.attacks import random_view, to_8_bit
from engine.lab.evaluate.machine import peak_memory_mb
from engine.lab.evaluate.marked_scene import bench_key, mark_scene
from engine.lab.evaluate.study import Row
from engine.lab.sim.attacks import image_attack
from engine.lab.sim.suite import Trial, apply_chain
from engine.raster import render

T = TypeVar("T")


def in_own_process(function: Callable[..., T], *arguments: object) -> T:
    """Result of a module-level function run in a fresh process."""
    context = get_context("spawn")
    with ProcessPoolExecutor(max_workers=1, mp_context=context, initializer=keep_freed_memory) as pool:
        return pool.submit(function, *arguments).result()


def spread(seconds: Sequence[float], name: str = "seconds") -> dict[str, float]:
    """Median and extremes of repeated timings."""
    return {name: statistics.median(seconds), f"{name}_least": min(seconds), f"{name}_most": max(seconds)}


def stage_medians(runs: Sequence[dict[str, float]]) -> dict[str, float]:
    """Median of each stage over runs."""
    return {stage: statistics.median(run[stage] for run in runs) for stage in runs[0]}


def seconds_of(work: Callable[[], object]) -> float:
    """Of one run."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def median_ms(work: Callable[[], object], repeats: int) -> float:
    """Milliseconds of `work`, median of `repeats` runs after one that is not timed."""
    work()
    return round(1000.0 * statistics.median(seconds_of(work) for _ in range(repeats)), 2)


def measure_embed(scene: str, seed: int, profile: str, repeats: int) -> list[Row]:
    """Embeddings of 32 bits: seconds, seconds by stage, peak memory, fidelity; in addition: first run, reading."""
    return in_own_process(_embed, scene, seed, profile, repeats)


def _embed(scene: str, seed: int, profile: str, repeats: int) -> list[Row]:
    began = time.perf_counter()
    loaded = read_model(scene)
    read_seconds = time.perf_counter() - began
    key, config = bench_key(seed), named_profile(profile)
    first, *timed = (
        embed(loaded.model, key, original_sha256=loaded.sha256, config=config).report for _ in range(repeats + 1)
    )
    row = {
        "scene": Path(scene).name,
        "gaussians": len(loaded.model),
        "sh_degree": loaded.model.sh_degree,
        **spread([report["seconds"] for report in timed]),
        "first_seconds": first["seconds"],
        "read_seconds": read_seconds,
        "seconds_by_stage": stage_medians([report["seconds_by_stage"] for report in timed]),
        "peak_memory_mb": peak_memory_mb(),
    }
    return [row | {name: timed[-1][name] for name in ("psnr_worst_view", "ssim_worst_view", "predicted_z_viewer")}]


def measure_verify(scene: str, seed: int, profile: str, repeats: int) -> list[Row]:
    """Verifications of one marked scene: seconds, seconds by stage, claim; peak memory with the embedding's.

    Suspects: the marked model moved, scaled and shuffled ("model"); one 800x800 picture from a known camera
    after JPEG 80 ("picture"); an 800x600 screenshot after JPEG 80 with an unknown camera ("screenshot").
    """
    return in_own_process(_verify, scene, seed, profile, repeats)


def _verify(path: str, seed: int, profile: str, repeats: int) -> list[Row]:
    scene = mark_scene(path, named_profile(profile), seed=seed)
    opened, jpeg = scene.opened, image_attack("jpeg")
    stolen = apply_chain(scene.marked, Trial("moved", (("similarity", 4.0), ("shuffle", 1.0)), "bench"), seed)
    camera = opened.cameras[0]
    picture = jpeg.apply(to_8_bit(render(scene.marked, camera)), 80)
    anywhere = random_view(scene.original, np.random.default_rng(seed), 800, 600)
    screenshot = jpeg.apply(to_8_bit(render(scene.marked, anywhere)), 80)
    suspects: dict[str, Callable[[], Verification]] = {
        "model": lambda: verify_model(stolen, opened),
        "picture": lambda: verify_images([picture], opened, cameras=[camera]),
        "screenshot": lambda: verify_images([screenshot], opened),
    }
    rows = []
    for name, check in suspects.items():
        timed = [check() for _ in range(repeats + 1)][1:]
        claim = timed[-1].claim
        rows.append(
            {
                "scene": scene.name,
                "gaussians": len(scene.original),
                "suspect": name,
                **spread([run.seconds for run in timed]),
                "seconds_by_stage": stage_medians([run.seconds_by_stage for run in timed]),
                "verdict": claim.verdict.value,
                "z": claim.z,
                "bit_accuracy": claim.bit_accuracy,
                "peak_memory_mb": peak_memory_mb(),
            }
        )
    return rows
