"""Which Gaussians of a model are ever drawn: anybody may add any number of others to a suspect, and nobody sees it."""

import math

import numpy as np

from engine.model import Bool, GaussianModel
from engine.raster.settings import ALPHA_SKIP

__all__ = ["FAINTEST", "HARDLY", "SMALLEST", "drawn", "only_drawn"]

_ROUNDED = 0.99
"""One step of 8-bit opacity is ALPHA_SKIP itself and counts as drawn; half floats store it up to 0.2 % off."""
FAINTEST = math.log(_ROUNDED * ALPHA_SKIP / (1.0 - _ROUNDED * ALPHA_SKIP))
"""Opacity logit below which no viewer draws a Gaussian: its alpha stays below one gray level at its very center."""
HARDLY = math.log(2.0 * ALPHA_SKIP / (1.0 - 2.0 * ALPHA_SKIP))
"""Opacity logit below which rounding or slight noise may make a Gaussian of an original one that no viewer draws."""
SMALLEST = math.log(1e-10)
"""Logarithm of the largest scale, scene units, below which a Gaussian has no size: a scale of zero is read as 1e-13."""


def drawn(model: GaussianModel, faintest: float = FAINTEST) -> Bool:
    """(N,) which Gaussians a viewer may draw: those that are neither too faint to be seen nor without a size."""
    return np.asarray((model.opacity_logits >= faintest) & (model.log_scales.max(axis=1, initial=-np.inf) >= SMALLEST))


def only_drawn(model: GaussianModel) -> GaussianModel:
    """The model without what no viewer draws; as it is where that would leave nothing."""
    seen = drawn(model)
    return model if seen.all() or not seen.any() else model.take(seen)
