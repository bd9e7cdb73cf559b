"""Gaussians to discs: the smallest axis is dropped."""

import numpy as np

from engine.model import DISC_THICKNESS, GaussianModel

__all__ = ["flatten"]

_TURNS = np.array([[0.5, 0.5, 0.5, 0.5], [0.5, -0.5, -0.5, -0.5], [1.0, 0.0, 0.0, 0.0]])
"""Quaternion that renames the axes in a circle until axis 0, 1 or 2 has become the third."""


def flatten(model: GaussianModel) -> GaussianModel:
    """The Gaussians as discs of 2DGS: their smallest axis becomes the third one, `DISC_THICKNESS` thin.

    Returns
    -------
    GaussianModel
        Same order, centres, colours and opacities; `is_flat`. Axes are renamed in a circle, so rotations stay
        rotations. Nothing makes up for the depth that is lost.
    """
    smallest = model.log_scales.argmin(axis=1)
    in_plane = (smallest[:, None] + [1, 2]) % 3
    kept = np.take_along_axis(model.log_scales, in_plane, axis=1)
    third = kept.min(axis=1, keepdims=True) + np.log(DISC_THICKNESS)
    return model.with_(
        log_scales=np.concatenate([kept, third], axis=1),
        quats=_product(model.quats.astype(np.float64), _TURNS[smallest]).astype(np.float32),
    )


def _product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(N, 4) Hamilton products, w first."""
    w = p[:, :1] * q[:, :1] - (p[:, 1:] * q[:, 1:]).sum(axis=1, keepdims=True)
    xyz = p[:, :1] * q[:, 1:] + q[:, :1] * p[:, 1:] + np.cross(p[:, 1:], q[:, 1:])
    return np.concatenate([w, xyz], axis=1)
