"""What Gaussians are as distributions: their covariances, their surfaces, their mass."""

import numpy as np
import scipy

from engine.model import Float64, GaussianModel

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
