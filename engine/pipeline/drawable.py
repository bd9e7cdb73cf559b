"""Models that would take the rasterizer hours are refused before it begins.

What drawing costs is told by the pairs of tile and Gaussian: a hundred thousand Gaussians that each cover the whole
picture are 250 million pairs in a view of 800 x 800, where a captured scene of half a million has one or two.
"""

from collections.abc import Sequence

import numpy as np

from engine.errors import InputError
from engine.model import Camera, GaussianModel
from engine.pipeline.rigs import LANDMARK_SIZE, make_rig
from engine.raster import count_overlaps
from engine.raster.settings import TILE

__all__ = ["check_drawable", "is_drawable"]

MOST_A_TILE = 20_000
"""Gaussians in a tile of the picture, averaged over its tiles."""
VIEWS = 4
"""Of a suspect, whose own cameras nobody knows."""


def check_drawable(model: GaussianModel, cameras: Sequence[Camera] = ()) -> None:
    """InputError if a view of the model (regular ones, where no cameras are given) would be too much to draw."""
    for number, camera in enumerate(cameras or make_rig(model, VIEWS, *LANDMARK_SIZE), start=1):
        tiles = -(-camera.width // TILE) * -(-camera.height // TILE)
        overlaps = count_overlaps(model, camera)
        each = overlaps.sum() / tiles
        if each > MOST_A_TILE:
            large = int(np.count_nonzero(overlaps > tiles // 4))
            raise InputError(
                f"this model takes too long to draw: in view {number} {each:,.0f} Gaussians reach an average tile of"
                f" {TILE} x {TILE} pixels, {MOST_A_TILE:,} are allowed; {large:,} of its {len(model):,} Gaussians cover"
                " more than a quarter of the picture"
            )


def is_drawable(model: GaussianModel) -> bool:
    """Whether `check_drawable` lets the model pass."""
    try:
        check_drawable(model)
    except InputError:
        return False
    return True
