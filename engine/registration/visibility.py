"""Which Gaussians of a model are ever drawn: others can be added to a suspect in any number, invisibly."""

import math

import numpy as np

from engine.model import Bool, GaussianModel
from engine.raster.settings import ALPHA_SKIP
from engine.registration.config import CONFIG

_ROUNDED, _HARDLY = CONFIG.visibility.rounded * ALPHA_SKIP, CONFIG.visibility.hardly * ALPHA_SKIP
FAINTEST = math.log(_ROUNDED / (1.0 - _ROUNDED))
"""Opacity logit below which no viewer draws a Gaussian: its alpha stays below one gray level at its very center."""
HARDLY = math.log(_HARDLY / (1.0 - _HARDLY))
"""Opacity logit below which rounding or slight noise may make a Gaussian of an original one that no viewer draws."""
SMALLEST = math.log(CONFIG.visibility.smallest)
"""Logarithm of the largest scale below which a Gaussian has no size."""


def drawn(model: GaussianModel, faintest: float = FAINTEST) -> Bool:
    """(N,) which Gaussians a viewer may draw: those that are neither too faint to be seen nor without a size."""
    return np.asarray((model.opacity_logits >= faintest) & (model.log_scales.max(axis=1, initial=-np.inf) >= SMALLEST))


def only_drawn(model: GaussianModel) -> GaussianModel:
    """The model without what no viewer draws; as it is where that would leave nothing."""
    seen = drawn(model)
    return model if seen.all() or not seen.any() else model.take(seen)
