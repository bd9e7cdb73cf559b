"""Deformations of a Gaussian model that no similarity undoes, with covariances carried along (F Sigma F^T)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from engine.model import Float64, GaussianModel
from engine.numerics.similarity import quaternion_to_rotation, rotation_to_quaternion

Field = Callable[[Float64], Float64]
"""Points (n, 3) to points (n, 3)."""


def deform(model: GaussianModel, field: Field) -> GaussianModel:
    """The model under a field: centres moved, covariances by its Jacobian (central differences), colours kept."""
    means = model.means.astype(np.float64)
    step = 1e-4 * float(np.ptp(means, axis=0).max())
    F = np.stack(
        [(field(means + step * e) - field(means - step * e)) / (2 * step) for e in np.eye(3)], axis=2
    )  # (n, 3, 3)
    axes = F @ (quaternion_to_rotation(model.quats) * np.exp(model.log_scales.astype(np.float64))[:, None, :])
    u, scales, _ = np.linalg.svd(axes)
    u[:, :, 2] *= np.sign(np.linalg.det(u))[:, None]
    return model.with_(
        means=field(means), log_scales=np.log(np.maximum(scales, 1e-12)), quats=rotation_to_quaternion(u)
    )


def frame(model: GaussianModel) -> tuple[Float64, float, int]:
    """Middle, half length along the longest axis (5 % to 95 %) and that axis."""
    low, high = np.quantile(model.means.astype(np.float64), [0.05, 0.95], axis=0)
    axis = int(np.argmax(high - low))
    return 0.5 * (low + high), 0.5 * float((high - low)[axis]), axis


def bend(model: GaussianModel, degrees: float) -> GaussianModel:
    """Bent by an angle over its length, into an arc about the next axis."""
    middle, half, axis = frame(model)
    up = (axis + 1) % 3
    curvature = np.radians(degrees) / (2 * half)

    def field(points: Float64) -> Float64:
        out = points - middle
        s, r = out[:, axis].copy(), 1.0 / curvature - out[:, up]
        out[:, axis], out[:, up] = r * np.sin(curvature * s), 1.0 / curvature - r * np.cos(curvature * s)
        return out + middle

    return deform(model, field)


def twist(model: GaussianModel, degrees: float) -> GaussianModel:
    """Twisted by an angle over its length, about its longest axis."""
    middle, half, axis = frame(model)
    a, b = (axis + 1) % 3, (axis + 2) % 3

    def field(points: Float64) -> Float64:
        out = points - middle
        angle = np.radians(degrees) * out[:, axis] / (2 * half)
        u, v = out[:, a].copy(), out[:, b].copy()
        out[:, a], out[:, b] = np.cos(angle) * u - np.sin(angle) * v, np.sin(angle) * u + np.cos(angle) * v
        return out + middle

    return deform(model, field)


def squash(model: GaussianModel, factor: float) -> GaussianModel:
    """Scaled along its longest axis alone."""
    middle, _, axis = frame(model)
    stretch = np.ones(3)
    stretch[axis] = factor
    return deform(model, lambda points: (points - middle) * stretch + middle)


def articulate(model: GaussianModel, degrees: float) -> GaussianModel:
    """The half beyond the middle of its longest axis turned like a limb, with a soft joint."""
    middle, half, axis = frame(model)
    a = (axis + 1) % 3

    def field(points: Float64) -> Float64:
        out = points - middle
        angle = np.radians(degrees) / (1.0 + np.exp(-out[:, axis] / (0.05 * half)))
        u, v = out[:, axis].copy(), out[:, a].copy()
        out[:, axis], out[:, a] = np.cos(angle) * u - np.sin(angle) * v, np.sin(angle) * u + np.cos(angle) * v
        return out + middle

    return deform(model, field)


CASES: dict[str, Callable[[GaussianModel], GaussianModel]] = {
    "bend 10": lambda m: bend(m, 10),
    "bend 30": lambda m: bend(m, 30),
    "bend 90": lambda m: bend(m, 90),
    "twist 30": lambda m: twist(m, 30),
    "twist 90": lambda m: twist(m, 90),
    "squash 0.5": lambda m: squash(m, 0.5),
    "articulate 45": lambda m: articulate(m, 45),
}
