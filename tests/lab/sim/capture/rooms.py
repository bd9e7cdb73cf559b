"""A furnished room, as points and as a model, and a scanner's walk through it."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from engine.lab.points.trajectory import Trajectory
from engine.lab.sim.capture.capture_kernels import flat_kernels_from_points
from engine.model import Float64, GaussianModel
from engine.numerics.similarity import rotation_to_quaternion

LOW, HIGH = np.array([-4.0, -3.0, 0.0]), np.array([4.0, 3.0, 3.0])
FURNITURE = (((-2, -1, 0), (-1, 0.5, 1)), ((1.5, -2, 0), (2.2, -1.2, 2)), ((0.5, 1.2, 0), (2.5, 2.2, 0.8)))


def on_box(low: Float64, high: Float64, count: int, rng: np.random.Generator) -> Float64:
    points = low + rng.random((count, 3)) * (high - low)
    face = rng.integers(6, size=count)
    points[np.arange(count), face % 3] = np.where(face < 3, low[face % 3], high[face % 3])
    return points


def room_points(count: int = 12000, seed: int = 0) -> tuple[Float64, Float64]:
    """Points on the surfaces, and a smooth color for each."""
    rng = np.random.default_rng(seed)
    parts = [on_box(LOW, HIGH, count, rng)]
    parts += [on_box(np.array(low), np.array(high), count // 8, rng) for low, high in FURNITURE]
    points = np.concatenate(parts)
    return points, 0.5 + 0.4 * np.sin(points * [1.1, 1.3, 1.7] + [0, 1, 2])


def room(count: int = 40000) -> GaussianModel:
    model = flat_kernels_from_points(*room_points(count))
    return model.with_(log_scales=model.log_scales + np.float32(np.log(1.2)))


def walk(count: int, times: bool = True) -> Trajectory:
    """Once around inside the room, looking left and right."""
    angles = np.linspace(0.0, 2 * np.pi, count)
    places = [0.9 * np.cos(angles) - 0.2, 0.5 + 0.6 * np.sin(angles), 1.4 + 0.1 * np.sin(2 * angles)]
    turns = Rotation.from_euler("z", 0.5 * np.sin(angles)[:, None])
    stamps = 100.0 + 0.1 * np.arange(count) if times else None
    return Trajectory(np.stack(places, axis=1), rotation_to_quaternion(turns.as_matrix()), stamps)


def from_surface(points: Float64) -> Float64:
    """(N,) distance to the nearest wall, floor, ceiling or piece of furniture."""
    found = []
    for low, high in ((LOW, HIGH), *((np.array(a), np.array(b)) for a, b in FURNITURE)):
        outside = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1)
        inside = np.minimum(points - low, high - points).min(axis=1)
        found.append(np.where(outside > 0.0, outside, inside))
    return np.min(found, axis=0)
