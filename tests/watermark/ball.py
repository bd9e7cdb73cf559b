"""A small textured ball with a mark on it, made step by step: seconds less than a whole embedding."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from engine.compress.hvq import HvqConfig, Stage, quantize
from engine.compress.impact import Impact, measure_impact
from engine.flows.views.camera_rig import make_rig
from engine.flows.views.view_set import ViewSet, look
from engine.model import Camera, GaussianModel
from engine.watermark.keys import OwnerKey
from engine.watermark.planning import Plan, PlanConfig, make_plan
from engine.watermark.spreading import Spreading, spread

KEY = OwnerKey(bytes(range(32)))


@dataclass(frozen=True, eq=False)
class Ball:
    """What an embedding knows of it on the way, at unit strength."""

    model: GaussianModel
    original: ViewSet
    impact: Impact
    stages: tuple[Stage, ...]
    plan: Plan
    spreading: Spreading
    message: np.ndarray
    signed: np.ndarray

    @property
    def cameras(self) -> list[Camera]:
        return list(self.original.cameras)

    @property
    def displacement(self) -> np.ndarray:
        """(N, 3) of the mark."""
        return self.plan.layout.displace(self.signed)


def ball_model(count: int, degree: int = 1, seed: int = 4) -> GaussianModel:
    """Gaussians on a sphere, of patchy colours that no view clamps."""
    rng = np.random.default_rng(seed)
    normal = rng.standard_normal((count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    sh = 0.03 * rng.standard_normal((count, (degree + 1) ** 2, 3))
    sh[:, 0] = 0.6 * np.sin(normal @ rng.normal(0, 4, (3, 3))) + 0.1 * rng.standard_normal((count, 3))
    return GaussianModel(
        normal.astype(np.float32),
        np.log(rng.uniform(1.2, 2.4, (count, 3)) / np.sqrt(count)).astype(np.float32),
        rng.standard_normal((count, 4)).astype(np.float32),
        rng.normal(1.5, 1.0, count).astype(np.float32),
        sh.astype(np.float32),
    )


@cache
def marked_ball(count: int = 900, views: int = 3, size: int = 96, stages: int = 1, bits: int = 16) -> Ball:
    """The ball under KEY; with two stages, residual codes carry a part."""
    model = ball_model(count)
    original = look(model, make_rig(model, views, size, size), lambda _: None)
    impact = measure_impact(model, original.views, original.images)
    codes = (64,) * (stages - 1)
    learnt = quantize(model, impact.squared + 1e-3, 1.0, HvqConfig(cells=128, residual_codes=codes, min_members=4))
    plan = make_plan(learnt, impact, PlanConfig(stages=stages))
    spreading = spread(KEY, b"ball", plan.layout.codes, 3, bits)
    message = np.where(np.arange(bits) % 3 == 0, 1, -1).astype(np.int8)
    signed = plan.layout.amplitudes * spreading.values(message)
    return Ball(model, original, impact, learnt, plan, spreading, message, signed)
