"""Gaussians merged into fewer, larger ones, each the sum of those it replaces."""

from __future__ import annotations

import numpy as np

from engine.model import Float64, GaussianModel, Int64
from engine.numerics.flattening import flatten
from engine.numerics.gaussians import covariances, ellipsoid_surface, surface_mass, volume_mass
from engine.numerics.similarity import rotation_to_quaternion

__all__ = ["merge_groups"]


def merge_groups(model: GaussianModel, group: Int64, *, surface: bool) -> GaussianModel:
    """One Gaussian for each group: `group` (N,) numbers them from 0, every number in use.

    Means, covariances and colours weigh by mass, which is opacity times `surface`, or else times volume. The opacity is
    what keeps the mass, at most 1, or else what the group lets through where all of it overlaps. A Gaussian alone in
    its group stays as it is.
    """
    sizes = np.bincount(group)
    first = np.empty(len(sizes), np.int64)
    first[group[::-1]] = np.arange(len(group))[::-1]
    result = model.take(first)
    touched = np.flatnonzero(sizes > 1)
    if not len(touched):
        return result
    rows = np.flatnonzero(sizes[group] > 1)
    part, of = model.take(rows), np.searchsorted(touched, group[rows])
    count = len(touched)
    mass = np.maximum(surface_mass(part) if surface else volume_mass(part), 1e-300)
    total = np.bincount(of, mass, count)
    share = mass / total[of]

    def mean_of(values: Float64) -> Float64:
        columns = values.reshape(len(values), -1)
        sums = [np.bincount(of, share * column, count) for column in columns.T]
        return np.asarray(np.stack(sums, axis=1).reshape(count, *values.shape[1:]), dtype=np.float64)

    means = part.means.astype(np.float64)
    center = mean_of(means)
    gap = means - center[of]
    values, vectors = np.linalg.eigh(mean_of(covariances(part) + gap[:, :, None] * gap[:, None, :]))
    vectors[np.linalg.det(vectors) < 0, :, 0] *= -1.0
    scales = np.sqrt(np.maximum(values, 1e-30))
    if surface:
        opacity = total / ellipsoid_surface(scales)
    else:
        opacity = -np.expm1(np.bincount(of, np.log1p(-np.minimum(part.opacities.astype(np.float64), 1 - 1e-7)), count))
    opacity = np.clip(opacity, 1e-6, 1 - 1e-6)
    result.means[touched] = center
    result.log_scales[touched] = np.log(scales)
    result.quats[touched] = rotation_to_quaternion(vectors)
    result.opacity_logits[touched] = np.log(opacity / (1 - opacity))
    result.sh[touched] = mean_of(part.sh.astype(np.float64))
    return flatten(result) if model.is_flat else result  # the gaps between discs of 2DGS do not make their sum thick
