"""The shipped scene with fewer Gaussians, for tests that ask how something works and not how well."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from engine.formats import encode_model, read_model
from engine.model import ATTRIBUTES, GaussianModel

PLANT = Path(__file__).parent / "data" / "plant.splat"


@cache
def sparse_plant(kind: str = "splat", every: int = 5) -> bytes:
    """Every so-manyth Gaussian of the plant as a file, each grown so far that no gaps open."""
    whole = read_model(PLANT).model
    few = whole.take(np.arange(0, len(whole), every))
    return encode_model(few.with_(log_scales=few.log_scales + np.float32(np.log(every) / 2)), kind)


def screened(model: GaussianModel, count: int, size: float = 5.0) -> GaussianModel:
    """A model behind so many faint Gaussians of a size in units of the model's own spread: by default each covers every
    picture of it."""
    veils = model.take(np.arange(count) % len(model))
    spread = float(np.abs(model.means - np.median(model.means, axis=0)).max())
    log_scales = np.full((count, 3), np.log(size * spread), np.float32)
    veils = veils.with_(log_scales=log_scales, opacity_logits=np.full(count, -4.0, np.float32))
    return model.with_(**{n: np.concatenate([getattr(model, n), getattr(veils, n)]) for n in ATTRIBUTES})
