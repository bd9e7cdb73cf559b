"""Gaussians to discs: the smallest axis is dropped."""

import numpy as np

from engine.model import DISC_THICKNESS, GaussianModel
from engine.numerics.similarity import quaternion_product

__all__ = ["flatten"]

_TURNS = np.array([[0.5, 0.5, 0.5, 0.5], [0.5, -0.5, -0.5, -0.5], [1.0, 0.0, 0.0, 0.0]])
"""Quaternion that renames the axes in a circle until axis 0, 1 or 2 has become the third."""


def flatten(model: GaussianModel) -> GaussianModel:
    """The Gaussians as discs of 2DGS (`is_flat`): their smallest axis becomes the third one, `DISC_THICKNESS` thin.

    Axes are renamed in a circle, so rotations stay rotations. Nothing makes up for the depth that is lost.
    """
    smallest = model.log_scales.argmin(axis=1)
    in_plane = (smallest[:, None] + [1, 2]) % 3
    kept = np.take_along_axis(model.log_scales, in_plane, axis=1)
    third = kept.min(axis=1, keepdims=True) + np.log(DISC_THICKNESS)
    return model.with_(
        log_scales=np.concatenate([kept, third], axis=1),  # (N, 3)
        quats=quaternion_product(model.quats, _TURNS[smallest]).astype(np.float32),
    )
