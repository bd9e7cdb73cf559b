"""2-D masks lifted to 3-D, and selections seen as 2-D masks: both by blending weight, in one pass a view."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Bool, Camera, Float32, Float64, GaussianModel
from engine.raster import prepare_view

__all__ = ["lift_masks", "mask_shares", "project_selection"]

LEAST_WEIGHT = 0.05
"""Blending weight (pixels, summed over the views) below which a Gaussian was not really seen: less than a
twentieth of one pixel says nothing about which side of a mask's edge it lies on."""

HIDDEN_NEIGHBORS = 8
"""Seen neighbours that decide for a Gaussian no view shows."""


def mask_shares(
    model: GaussianModel, cameras: Sequence[Camera], masks: Sequence[npt.NDArray[np.generic]]
) -> tuple[Float64, Float64]:
    """Which share of each Gaussian's visible weight lies inside the masks.

    Masks are (H, W) bool or float, one a camera, of its size; numbers 0 to 1 for soft edges.

    Returns
    -------
    share : (N,) float64
        sum over views and pixels of w * mask / sum of w, w = alpha T the blending weight; 0 where not seen.
    weight : (N,) float64
        sum of w, pixels.
    """
    if not cameras or len(cameras) != len(masks):
        raise InputError(f"each camera needs one mask, got {len(cameras)} cameras and {len(masks)} masks")
    inside, total = np.zeros(len(model)), np.zeros(len(model))
    for number, (camera, mask) in enumerate(zip(cameras, masks, strict=True)):
        pixels = np.asarray(mask)
        if pixels.shape != (camera.height, camera.width):
            raise InputError(f"mask {number} has shape {pixels.shape}, its camera ({camera.height}, {camera.width})")
        pixels = pixels.astype(np.float32)
        if not (pixels.min() >= 0 and pixels.max() <= 1):
            raise InputError(f"mask {number} has values from {pixels.min()} to {pixels.max()}, expected 0 to 1")
        view = prepare_view(model, camera)
        inside += view.weighted(pixels)[0]
        total += view.weights()[0]
    return np.divide(inside, total, out=np.zeros_like(total), where=total > 0), total


def lift_masks(
    model: GaussianModel,
    cameras: Sequence[Camera],
    masks: Sequence[npt.NDArray[np.generic]],
    *,
    threshold: float = 0.5,
    hidden: bool = True,
) -> Bool:
    """(N,) bool: Gaussians that masks in one or several views (see `mask_shares`) show.

    Parameters
    ----------
    threshold : float
        Share of a Gaussian's visible weight that must lie inside, (0, 1). At 0.5 it belongs to the side that
        shows more of it; higher values keep the selection off the mask's edge, lower ones reach across.
    hidden : bool
        Whether Gaussians that no view shows (the inside of an object, its back) follow the majority of their
        nearest seen neighbours in space. If not, they are left out.
    """
    if not 0 < threshold < 1:
        raise InputError(f"threshold must lie in (0, 1), got {threshold}")
    share, weight = mask_shares(model, cameras, masks)
    seen = weight >= LEAST_WEIGHT
    chosen = seen & (share >= threshold)
    if hidden and chosen.any() and not seen.all():
        from scipy.spatial import cKDTree

        judges = np.flatnonzero(seen)
        k = min(HIDDEN_NEIGHBORS, len(judges))
        _, near = cKDTree(model.means[judges]).query(model.means[~seen], k=k)
        chosen[~seen] = share[judges[near.reshape(-1, k)]].mean(axis=1) >= threshold
    return chosen


def project_selection(model: GaussianModel, selection: Bool, camera: Camera) -> Float32:
    """(H, W) float32, 0 to 1: the part of each pixel's colour that comes from the selected Gaussians.

    What stands in front of the selection hides it. 0.5 and above is the selection's mask in this view.
    """
    if selection.shape != (len(model),):
        raise InputError(f"a selection must have shape ({len(model)},), got {selection.shape}")
    image, _ = prepare_view(model, camera).render(selection.astype(np.float32)[:, None])
    return np.clip(image[..., 0], 0.0, 1.0)
