"""What Gaussians are as distributions: covariances, surfaces, mass.

Flattened to discs, and merged into fewer ones, each the sum of those it replaces.
"""

import numpy as np
import scipy

from engine.model import DISC_THICKNESS, Float64, GaussianModel, Int64
from engine.numerics.similarity import quaternion_product, rotation_to_quaternion

_THOMSEN = 1.6075


def covariances(model: GaussianModel) -> Float64:
    """(N, 3, 3) covariance matrices R S S^T R^T (Eq 2)."""
    rotation = scipy.spatial.transform.Rotation.from_quat(model.quats.astype(np.float64)[:, [1, 2, 3, 0]]).as_matrix()
    half = rotation * np.exp(model.log_scales.astype(np.float64))[:, None, :]
    return np.asarray(half @ half.transpose(0, 2, 1))


def ellipsoid_surface(scales: Float64) -> Float64:
    """(n,) surface of ellipsoids with semi-axes (n, 3), by Knud Thomsen's formula: within 1.1 %."""
    a, b, c = (np.maximum(scales, 1e-30) ** _THOMSEN).T
    return np.asarray(4.0 * np.pi * ((a * b + a * c + b * c) / 3.0) ** (1.0 / _THOMSEN))


def surface_mass(model: GaussianModel) -> Float64:
    """(N,) opacity times the surface of the ellipsoid of one standard deviation: what tools that merge conserve."""
    return model.opacities.astype(np.float64) * ellipsoid_surface(np.exp(model.log_scales.astype(np.float64)))


def volume_mass(model: GaussianModel) -> Float64:
    """(N,) opacity times the product of the standard deviations."""
    return np.asarray(model.opacities.astype(np.float64) * np.exp(model.log_scales.astype(np.float64).sum(axis=1)))


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
