"""The surface that a hole was cut out of: a quadric height field through the ring of Gaussians around it."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.model import Bool, Float64, GaussianModel, Int64

__all__ = ["HoleSurface", "fit_surface", "ring_around", "visible_area"]

PLANES = 400
"""Planes tried through three ring Gaussians each: with a fifth of them on the surface, all 400 miss it with
probability 4 %, with a third of them never."""

TUKEY = 4.685 * 1.4826
"""Tukey's constant times the standard deviation of a normal law over its median absolute deviation."""

PLANE_BAND, WIDEST_BAND, FINEST_BAND = 0.15, 0.5, 0.02
"""Distances that count as on the plane, and as on the quadric at first and at last, in radii of the hole."""

BENDING = 0.02  # cost of the quadric's second derivatives: a ring says little about them far inside the hole
LEAST_RING = 24  # ring Gaussians below which no surface is fitted: a quadric has 6 coefficients


@dataclass(frozen=True, eq=False)
class HoleSurface:
    """x(u, v) = origin + u e1 + v e2 + height(u, v) normal, lengths in scene units."""

    origin: Float64  # (3,)
    axes: Float64  # (3, 3) rows e1, e2 and the normal; right-handed
    coefficients: Float64  # (6,) of 1, u, v, u^2, u v, v^2 in the height, u and v divided by `size`
    size: float  # length that the coefficients count in
    band: float  # heights above or below the surface within which a Gaussian belongs to it

    def local(self, points: npt.NDArray[np.generic]) -> Float64:
        """(n, 3) u, v and height above the surface of points (n, 3)."""
        flat = (points.astype(np.float64) - self.origin) @ self.axes.T
        flat[:, 2] -= self._height(flat[:, :2])
        return np.asarray(flat)

    def world(self, local: Float64) -> Float64:
        """(n, 3) points of u, v and height (n, 3)."""
        flat = local.copy()
        flat[:, 2] += self._height(local[:, :2])
        return np.asarray(flat @ self.axes + self.origin)

    def normals(self, uv: Float64) -> Float64:
        """(n, 3) unit normals at (n, 2)."""
        u, v = uv[:, 0] / self.size, uv[:, 1] / self.size
        _, b, c, d, e, f = self.coefficients / self.size
        slope = np.stack([-(b + 2 * d * u + e * v), -(c + e * u + 2 * f * v), np.ones_like(u)], axis=1)
        slope /= np.linalg.norm(slope, axis=1, keepdims=True)
        return np.asarray(slope @ self.axes)

    def _height(self, uv: Float64) -> Float64:
        return np.asarray(_quadric(uv / self.size) @ self.coefficients)


def visible_area(model: GaussianModel) -> Float64:
    """(n,) opacity times the area of the two larger axes, capped at its 95 % quantile: who makes a surface."""
    log_area = np.sort(model.log_scales.astype(np.float64), axis=1)[:, 1:].sum(axis=1)
    area = np.exp(np.minimum(log_area, np.quantile(log_area, 0.95)) - log_area.max())
    return np.asarray(model.opacities.astype(np.float64) * area)


def ring_around(model: GaussianModel, selection: Bool, width: float, least: int) -> Int64:
    """Unselected Gaussians within `width` (scene units) of a selected one; wider until `least` are found."""
    from scipy.spatial import cKDTree

    rest = np.flatnonzero(~selection)
    distance, _ = cKDTree(model.means[selection]).query(model.means[rest], workers=1)
    reach = max(width, float(np.sort(distance)[min(least, len(rest)) - 1]))
    return np.asarray(rest[distance <= reach], dtype=np.int64)


def fit_surface(ring: GaussianModel, hole: GaussianModel, size: float, rng: np.random.Generator) -> HoleSurface | None:
    """The dominant surface through a ring, facing the side on which the hole's Gaussians were.

    The dominant plane by RANSAC, weighted by visible area; then a quadric by Tukey's biweight with a band that closes
    in. `size` is the hole's radius, scene units. None where the ring is too small or spans no plane.
    """
    if len(ring) < LEAST_RING:
        return None
    points, weights = ring.means.astype(np.float64), visible_area(ring)
    if not weights.sum() > 0:
        return None
    found = _dominant_plane(points, weights, PLANE_BAND * size, rng)
    if found is None:
        return None
    origin, normal = found
    if (np.median(hole.means.astype(np.float64), axis=0) - origin) @ normal < 0:
        normal = -normal
    e1 = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    e1 /= np.linalg.norm(e1)
    axes = np.stack([e1, np.cross(normal, e1), normal])
    local = (points - origin) @ axes.T  # (n, 3) u, v, height above the plane
    design, height = _quadric(local[:, :2] / size), local[:, 2]  # (n, 6), (n,)
    coefficients = np.zeros(6)
    band = WIDEST_BAND * size
    stiff = np.diag([0.0, 0.0, 0.0, BENDING, BENDING, BENDING])
    for _ in range(12):
        error = height - design @ coefficients
        w = weights * np.square(np.clip(1.0 - np.square(error / band), 0.0, None))
        if np.count_nonzero(w) < LEAST_RING // 2:
            break
        normal_matrix = (design * w[:, None]).T @ design / w.sum() + stiff + 1e-9 * np.eye(6)
        coefficients = np.linalg.solve(normal_matrix, (design * w[:, None]).T @ height / w.sum())
        near = np.abs(height - design @ coefficients) < band
        spread = _weighted_median(np.abs(height - design @ coefficients)[near], weights[near])
        band = min(band, max(TUKEY * spread, FINEST_BAND * size))
    return HoleSurface(origin, axes, coefficients, size, band)


def _dominant_plane(
    points: Float64, weights: Float64, tolerance: float, rng: np.random.Generator
) -> tuple[Float64, Float64] | None:
    """A point and the unit normal of the plane with most weight within the tolerance."""
    chance = weights / weights.sum()
    best, answer = 0.0, None
    for _ in range(PLANES):
        a, b, c = points[rng.choice(len(points), 3, replace=False, p=chance)]
        normal = np.cross(b - a, c - a)
        length = float(np.linalg.norm(normal))
        if length < 1e-3 * tolerance**2:
            continue
        normal /= length
        explained = float(weights[np.abs((points - a) @ normal) < tolerance].sum())
        if explained > best:
            best, answer = explained, (a, normal)
    if answer is None:
        return None
    inside = np.abs((points - answer[0]) @ answer[1]) < tolerance
    w = weights[inside] / weights[inside].sum()
    center = w @ points[inside]
    spread = points[inside] - center
    _, vectors = np.linalg.eigh((spread * w[:, None]).T @ spread)
    return center, np.asarray(vectors[:, 0])


def _weighted_median(values: Float64, weights: Float64) -> float:
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(cumulative, 0.5 * cumulative[-1])]])


def _quadric(uv: Float64) -> Float64:
    u, v = uv[:, 0], uv[:, 1]
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
