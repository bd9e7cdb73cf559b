"""Speed of physics and of training on real scenes (`mark3dgs bench life`)."""

import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from engine.formats import read_model
from engine.model import GaussianModel
from engine.pipeline.rigs import make_rig
from engine.raster import render
from engine.sim.capture.training import TrainConfig, Trainer
from engine.sim.physics.body import kernel_means, make_body, pose
from engine.sim.physics.world import World, ground, step

KERNELS = 100_000
"""Of the bar on physics."""
TRAINED, TRAINED_SIZE = 200_000, 400
"""Gaussians and pixels a side of the bar on training."""
_FRAMES = 12
_ITERATIONS = 20


def bench_physics(path: Path, repeats: int, seed: int = 0) -> dict[str, Any]:
    """A model dropped on the ground: milliseconds of a step, of the kernels' centres, of the whole posed model."""
    model = _some(read_model(path).model, KERNELS, seed)
    body = make_body(model)
    floor = float(body.lattice.points[:, 1].min()) - 0.1 * float(np.ptp(body.lattice.points[:, 1]))
    world = World((body,), planes=(ground(floor),))
    world = step(world)  # compiled and warm
    steps, centers, poses = [], [], []
    for _ in range(max(_FRAMES, repeats)):
        begun = time.perf_counter()
        world = step(world)
        steps.append(time.perf_counter() - begun)
        centers.append(_timed(partial(kernel_means, world.bodies[0])))
        poses.append(_timed(partial(pose, world.bodies[0])))
    ms = [1e3 * statistics.median(values) for values in (steps, centers, poses)]
    return {
        "scene": path.name,
        "kernels": len(model),
        "tetrahedra": len(body.lattice.tets),
        "step_ms": ms[0],
        "centers_ms": ms[1],
        "pose_ms": ms[2],
        "steps_per_s": 1e3 / (ms[0] + ms[1]),
        "posed_steps_per_s": 1e3 / (ms[0] + ms[2]),
    }


def bench_training(path: Path, repeats: int, seed: int = 0) -> dict[str, Any]:
    """Iterations a second of training all parameters (SSIM and L1) of a disturbed model towards its own pictures."""
    model = _some(read_model(path).model, TRAINED, seed)
    cameras = make_rig(model, 6, TRAINED_SIZE, TRAINED_SIZE)
    images = [np.clip(render(model, camera), 0.0, 1.0) for camera in cameras]
    noise = np.random.default_rng(seed).normal(0.0, 0.1, model.sh.shape).astype(np.float32)
    config = TrainConfig(steps=1_000, densify=None, sh_degree=None)
    trainer = Trainer(model.with_(sh=model.sh + noise), cameras, images, config)
    for _ in range(4):
        trainer.step()
    begun = [_timed(trainer.step) for _ in range(max(_ITERATIONS, repeats))]
    return {
        "scene": path.name,
        "gaussians": len(model),
        "sh_degree": model.sh_degree,
        "pixels": TRAINED_SIZE,
        "iteration_ms": 1e3 * statistics.median(begun),
        "iterations_per_s": 1.0 / statistics.median(begun),
    }


def _some(model: GaussianModel, count: int, seed: int) -> GaussianModel:
    if len(model) <= count:
        return model
    return model.take(np.sort(np.random.default_rng(seed).choice(len(model), count, replace=False)))


def _timed(work: Callable[[], object]) -> float:
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun
