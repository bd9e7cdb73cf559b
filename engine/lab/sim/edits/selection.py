"""Which Gaussians an edit is about: boolean selections from boxes, spheres, segments and 2-D masks.

A selection is a (N,) bool array; unite, intersect and invert them with NumPy's |, & and ~. Masks are lifted to 3-D,
and selections seen as 2-D masks, by blending weight, in one pass a view.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.lab.sim.attack import check_positive
from engine.lab.sim.vectors import check_triple
from engine.model import SH_C0, Bool, Camera, Float64, GaussianModel, Int32, Int64
from engine.raster import prepare_view

SEGMENT_SAMPLE = 40_000  # Gaussians on which the centers of segments are learnt; every Gaussian is then assigned once
FLOATING = 2.0  # robust radii from the center beyond which a Gaussian is a floater
COLOR_WEIGHT = 0.3  # of a unit of color (black to white) in segments, robust radii of the model
SEGMENT_ROUNDS = 20  # Lloyd iterations; the assignment of real scenes settles within 10 to 15

LEAST_WEIGHT = 0.05
"""Blending weight (pixels, summed over the views) below which a Gaussian was not really seen: less than a
twentieth of one pixel says nothing about which side of a mask's edge it lies on."""

INSIDE = 0.5  # share of its visible weight from which a Gaussian is inside a mask
HIDDEN_NEIGHBORS = 8  # seen neighbors that decide for a Gaussian no view shows


def check_selection(model: GaussianModel, selection: npt.ArrayLike) -> Int64:
    """(n,) ascending indices of the selected Gaussians; InputError unless (N,) bool with n >= 1."""
    mask = np.asarray(selection)
    if mask.dtype != np.bool_ or mask.shape != (len(model),):
        raise InputError(f"a selection must be bool of shape ({len(model)},), got {mask.dtype} of shape {mask.shape}")
    rows = np.flatnonzero(mask)
    if not len(rows):
        raise InputError(f"the selection holds none of the {len(model)} Gaussians")
    return rows.astype(np.int64)


def select_box(model: GaussianModel, low: npt.ArrayLike, high: npt.ArrayLike) -> Bool:
    """(N,) bool: Gaussians whose center lies in a box of corners low <= high (3,), scene units, faces included."""
    bottom, top = check_triple(low, "low"), check_triple(high, "high")
    if (bottom > top).any():
        raise InputError(f"a box needs low <= high, got {bottom.tolist()} and {top.tolist()}")
    offset = model.means.astype(np.float64) - 0.5 * (bottom + top)
    return np.asarray((np.abs(offset) <= 0.5 * (top - bottom)).all(axis=1))


def select_sphere(model: GaussianModel, center: npt.ArrayLike, radius: float) -> Bool:
    """Gaussians whose center lies within `radius` (scene units, > 0) of `center` (3,); (N,) bool."""
    offset = model.means.astype(np.float64) - check_triple(center, "center")
    return np.asarray(np.einsum("ij,ij->i", offset, offset) <= check_positive(radius, "radius") ** 2)


def segment(model: GaussianModel, count: int) -> Int32:
    """(N,) segment of each Gaussian, 0 .. count-1, by k-means over position and base color, the most populous first.

    Segments may be empty where the model holds fewer distinct Gaussians than `count`.
    """
    from scipy.cluster.vq import kmeans2  # k-means++ and Lloyd: not this project's business
    from scipy.spatial import cKDTree

    from engine.flows.views.camera_rig import measure_extent

    if not 1 <= count <= len(model):
        raise InputError(f"segments must number 1 to {len(model)}, got {count}")
    extent = measure_extent(model)
    position = (model.means.astype(np.float64) - extent.center) / extent.radius
    color = np.clip(0.5 + SH_C0 * model.sh[:, 0].astype(np.float64), 0.0, 1.0)
    # A floater at ten radii must not get a segment of its own: beyond two, distance grows as its logarithm.
    distance = np.linalg.norm(position, axis=1, keepdims=True)
    beyond = np.maximum(distance, FLOATING)
    position = position * np.where(distance > FLOATING, (FLOATING + np.log(beyond / FLOATING)) / beyond, 1.0)
    features = np.concatenate([position, COLOR_WEIGHT * color], axis=1)
    rng = np.random.default_rng(0)
    sample = features
    if len(features) > SEGMENT_SAMPLE:
        sample = features[np.sort(rng.choice(len(features), max(SEGMENT_SAMPLE, count), replace=False))]
    centers, _ = kmeans2(sample, count, iter=SEGMENT_ROUNDS, minit="++", missing="warn", rng=rng)
    _, labels = cKDTree(centers).query(features)
    order = np.argsort(-np.bincount(labels, minlength=count), kind="stable")
    rank = np.argsort(order).astype(np.int32)  # the inverse of that order
    return np.asarray(rank[labels])


def segment_at(model: GaussianModel, labels: Int32, points: npt.ArrayLike) -> Bool:
    """(N,) bool: Gaussians of the segments (see `segment`) in which points (3,) or (n, 3) lie.

    Each point stands for the segment of the nearest Gaussian.
    """
    from scipy.spatial import cKDTree

    if labels.shape != (len(model),):
        raise InputError(f"labels must have shape ({len(model)},), got {labels.shape}")
    at = np.atleast_2d(np.asarray(points, dtype=np.float64))
    if at.ndim != 2 or at.shape[1] != 3 or not np.isfinite(at).all():
        raise InputError(f"points must be finite triples, got {points!r}")
    _, nearest = cKDTree(model.means).query(at)
    return np.isin(labels, labels[nearest])


def mask_shares(
    model: GaussianModel, cameras: Sequence[Camera], masks: Sequence[npt.NDArray[np.generic]]
) -> tuple[Float64, Float64]:
    """Which share (N,) of each Gaussian's visible weight lies inside the masks, and that weight (N,), pixels.

    With w = alpha T the blending weights, over views and pixels: sum of w * mask / sum of w (0 where not seen), and
    sum of w. Masks are (H, W) bool or float, one a camera, of its size; numbers 0 to 1 for soft edges.
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
        inside += view.backward_colors(pixels[:, :, None])[:, 0]
        total += view.weights()[0]
    return np.divide(inside, total, out=np.zeros_like(total), where=total > 0), total


def lift_masks(model: GaussianModel, cameras: Sequence[Camera], masks: Sequence[npt.NDArray[np.generic]]) -> Bool:
    """(N,) bool: Gaussians that masks in one or several views (see `mask_shares`) show.

    Half of a Gaussian's visible weight must lie inside. Gaussians that no view shows (the inside of an object, its
    back) follow the majority of their nearest seen neighbors in space.
    """
    share, weight = mask_shares(model, cameras, masks)
    seen = weight >= LEAST_WEIGHT
    chosen = seen & (share >= INSIDE)
    if chosen.any() and not seen.all():
        from scipy.spatial import cKDTree

        judges = np.flatnonzero(seen)
        k = min(HIDDEN_NEIGHBORS, len(judges))
        _, near = cKDTree(model.means[judges]).query(model.means[~seen], k=k)
        chosen[~seen] = share[judges[near.reshape(-1, k)]].mean(axis=1) >= INSIDE
    return chosen
