"""Slow twin of `engine.scenes.spacetime`: one Gaussian at one moment, formula by formula."""

from __future__ import annotations

import math

import numpy as np

from engine.model import Float64
from engine.scenes.spacetime import SpacetimeModel


def gaussian_at(model: SpacetimeModel, i: int, time: float) -> tuple[float, Float64, Float64]:
    """Opacity, centre (3,) and unit quaternion (4,) of Gaussian i."""
    d = time - float(model.trbf_center[i])
    sigmoid = 1.0 / (1.0 + math.exp(-float(model.opacity_logits[i])))
    opacity = sigmoid * math.exp(-((d / math.exp(float(model.trbf_scale[i]))) ** 2))
    motion = model.motion[i].astype(float)
    mean = np.array(
        [
            float(model.means[i, axis]) + motion[axis] * d + motion[3 + axis] * d**2 + motion[6 + axis] * d**3
            for axis in range(3)
        ]
    )
    quat = model.quats[i].astype(float) + d * model.omega[i].astype(float)
    return opacity, mean, quat / math.sqrt(float((quat**2).sum()))
