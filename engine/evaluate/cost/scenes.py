"""Real scenes of any size: thinned, or laid out as a grid of turned copies."""

import math

import numpy as np

from engine.model import GaussianModel
from engine.numerics.similarity import transform_model
from engine.pipeline.rigs import measure_extent

__all__ = ["sized"]

SPACING = 2.0
"""Between copies, in robust radii: neighbours touch and hide one another in part, as houses of a town do."""


def sized(model: GaussianModel, count: int, seed: int = 0) -> GaussianModel:
    """A scene of exactly `count` Gaussians made of a real one.

    Parameters
    ----------
    count : int
        Fewer than the model has: a random choice of them. More: copies on a square grid, each turned about the up
        axis by an angle of its own, the last one thinned.

    Returns
    -------
    GaussianModel
        Memory: its own arrays and one copy of the model.
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
