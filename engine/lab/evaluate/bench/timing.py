"""How long embedding, verifying, physics and training take, stage by stage, and how much memory an embedding needs.

Contract: every scene is marked and verified in a process of its own, so that its peak memory is its own; one run warms
up (kernels, file cache) and is thrown away, then come the timed ones; medians are reported, with extremes.
"""

import statistics
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

import numpy as np

from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import profile as named_profile
from engine.flows.verify.search import Verification, verify_images, verify_model
from engine.flows.views.camera_rig import make_rig
from engine.formats import read_model
from engine.kernels.allocation import keep_freed_memory
from engine.lab.evaluate.bench.attacks import random_view, to_8_bit
from engine.lab.evaluate.machine import peak_memory_mb
from engine.lab.evaluate.marked_scene import bench_key, mark_scene
from engine.lab.evaluate.study import Row
from engine.lab.sim.attacks import image_attack
from engine.lab.sim.suite import Trial, apply_chain
from engine.model import GaussianModel
from engine.raster import render

KERNELS = 100_000
"""Of the bar on physics."""
TRAINED, TRAINED_SIZE = 200_000, 400
"""Gaussians and pixels a side of the bar on training."""
FRAMES, ITERATIONS = 12, 20
"""Least runs of physics and of training that are timed."""

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


def measure_life(scene: str, seed: int, repeats: int) -> list[Row]:
    """Speed of physics and of training."""
    model, name = read_model(scene).model, Path(scene).name
    return [
        {"what": "physics", "scene": name, **_physics(_some(model, KERNELS, seed), repeats)},
        {"what": "training", "scene": name, **_training(_some(model, TRAINED, seed), repeats, seed)},
    ]


def _physics(model: GaussianModel, repeats: int) -> Row:
    """A model dropped on the ground: milliseconds of a step, of the kernels' centres, of the whole posed model."""
    from engine.lab.sim.physics.body import kernel_means, make_body, pose
    from engine.lab.sim.physics.world import World, ground, step

    body = make_body(model)
    floor = float(body.lattice.points[:, 1].min()) - 0.1 * float(np.ptp(body.lattice.points[:, 1]))
    world = step(World((body,), planes=(ground(floor),)))  # compiled and warm
    steps, centers, poses = [], [], []
    for _ in range(max(FRAMES, repeats)):
        began = time.perf_counter()
        world = step(world)
        steps.append(time.perf_counter() - began)
        centers.append(seconds_of(partial(kernel_means, world.bodies[0])))
        poses.append(seconds_of(partial(pose, world.bodies[0])))
    step_ms, centers_ms, pose_ms = (1e3 * statistics.median(values) for values in (steps, centers, poses))
    return {
        "kernels": len(model),
        "tetrahedra": len(body.lattice.tets),
        "step_ms": step_ms,
        "centers_ms": centers_ms,
        "pose_ms": pose_ms,
        "steps_per_s": 1e3 / (step_ms + centers_ms),
        "posed_steps_per_s": 1e3 / (step_ms + pose_ms),
    }


def _training(model: GaussianModel, repeats: int, seed: int) -> Row:
    """Iterations a second of training all parameters (SSIM and L1) of a disturbed model towards its own pictures."""
    from engine.lab.sim.capture.trainer import TrainConfig, Trainer

    cameras = make_rig(model, 6, TRAINED_SIZE, TRAINED_SIZE)
    images = [np.clip(render(model, camera), 0.0, 1.0) for camera in cameras]
    noise = np.random.default_rng(seed).normal(0.0, 0.1, model.sh.shape).astype(np.float32)
    config = TrainConfig(steps=1_000, densify=None, sh_degree=None)
    trainer = Trainer(model.with_(sh=model.sh + noise), cameras, images, config)
    for _ in range(4):
        trainer.step()
    seconds = statistics.median(seconds_of(trainer.step) for _ in range(max(ITERATIONS, repeats)))
    return {
        "gaussians": len(model),
        "sh_degree": model.sh_degree,
        "pixels": TRAINED_SIZE,
        "iteration_ms": 1e3 * seconds,
        "iterations_per_s": 1.0 / seconds,
    }


def _some(model: GaussianModel, count: int, seed: int) -> GaussianModel:
    if len(model) <= count:
        return model
    return model.take(np.sort(np.random.default_rng(seed).choice(len(model), count, replace=False)))
