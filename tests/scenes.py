"""The shipped scene with fewer Gaussians, for tests that ask how something works and not how well."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from engine.formats import encode_model, read_model

PLANT = Path(__file__).parent / "data" / "plant.splat"


@cache
def sparse_plant(kind: str = "splat", every: int = 5) -> bytes:
    """Every so-manyth Gaussian of the plant as a file, each grown so far that no gaps open."""
    whole = read_model(PLANT).model
    few = whole.take(np.arange(0, len(whole), every))
    return encode_model(few.with_(log_scales=few.log_scales + np.float32(np.log(every) / 2)), kind)
