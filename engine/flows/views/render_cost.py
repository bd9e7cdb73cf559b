"""Models that would take the rasterizer hours are refused before it begins.

The cost of drawing follows from the pairs of tile and Gaussian: a hundred thousand Gaussians that each cover the whole
picture are 250 million pairs in a view of 800 x 800, where captured scenes of half a million have one.
"""

from collections.abc import Sequence

import numpy as np

from engine.errors import InputError
from engine.flows.views.camera_rig import make_rig
from engine.flows.views.config import CONFIG
from engine.model import Camera, GaussianModel
from engine.raster import count_overlaps
from engine.raster.settings import TILE

_CONFIG = CONFIG.cost


def check_drawable(model: GaussianModel, cameras: Sequence[Camera] = ()) -> None:
    """InputError if a view of the model (regular ones, where no cameras are given) would be too much to draw."""
    for number, camera in enumerate(cameras or make_rig(model, _CONFIG.views, _CONFIG.side, _CONFIG.side), start=1):
        seen = camera.with_side(_CONFIG.side)
        overlaps = count_overlaps(model, seen)
        pairs = int(overlaps.sum())
        if pairs > _CONFIG.most_pairs:
            large = int(np.count_nonzero(4 * TILE**2 * overlaps > seen.width * seen.height))
            raise InputError(
                f"this model takes too long to draw: its Gaussians cover {pairs / 1e6:,.0f} million tiles of view"
                f" {number}, all added up, and {_CONFIG.most_pairs / 1e6:.0f} million are allowed; {large:,} of its"
                f" {len(model):,} Gaussians cover more than a quarter of it"
            )


def is_drawable(model: GaussianModel) -> bool:
    """Whether `check_drawable` lets the model pass."""
    try:
        check_drawable(model)
    except InputError:
        return False
    return True
