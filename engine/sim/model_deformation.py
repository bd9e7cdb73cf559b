"""Attacks that deform a model: it keeps every Gaussian and looks like the same thing, bent out of shape.

All are pure functions `(model, strength, rng) -> model`, along the longest extent of the model.
"""

import numpy as np

from engine.model import GaussianModel
from engine.sim.physics import deformations

__all__ = ["bend", "squash", "twist"]


def bend(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Bend to an arc of `strength` degrees, towards a random side."""
    side = rng.standard_normal(3)  # its part along the axis does not count
    return deformations.bend(model, strength, toward=side)


def twist(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Turn the two ends against each other by `strength` degrees, in a random sense."""
    return deformations.twist(model, strength if rng.random() < 0.5 else -strength)


def squash(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Press together by `strength` of the length; the middle bulges, the volume stays."""
    return deformations.squash(model, strength)
