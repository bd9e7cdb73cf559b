"""A camera as a handful of numbers, how pixels move when they change, and its fit to 3-D points seen in 2-D."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.model import Camera, Float64

__all__ = ["FREE_ALL", "FREE_CENTERED", "fit_pose", "moved", "pixel_motion", "project", "unit_camera"]

FREE_CENTERED = 7
"""Rotation 3, translation 3, focal length 1; the principal point stays where it is."""
FREE_ALL = 9
"""And the principal point: a picture that was cropped."""


def unit_camera(rotation: Float64, translation: Float64, focal: float, width: int, height: int) -> Camera:
    """Camera with square pixels and the principal point at the picture's centre."""
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = rotation, translation
    K = np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    return Camera(viewmat, K, width, height)


def moved(camera: Camera, step: Float64) -> Camera:
    """The camera after a step.

    Parameters
    ----------
    camera : Camera
    step : (7,) or (9,)
        Rotation vector (radians) and shift of the scene in the camera's frame, change of the logarithm of the
        focal length, and the shift of the principal point in focal lengths.

    Returns
    -------
    Camera
    """
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(step[:3]).as_matrix()
    viewmat = np.eye(4)
    viewmat[:3, :3] = turn @ camera.viewmat[:3, :3]
    viewmat[:3, 3] = turn @ camera.viewmat[:3, 3] + step[3:6]
    K = camera.K.copy()
    if len(step) == FREE_ALL:
        K[0, 2] += K[0, 0] * step[7]
        K[1, 2] += K[1, 1] * step[8]
    K[:2, :2] *= np.exp(np.clip(step[6], -0.5, 0.5))
    return Camera(viewmat, K, camera.width, camera.height)


def project(camera: Camera, points: Float64) -> tuple[Float64, Float64]:
    """(P, 2) pixels and (P, 3) camera coordinates of world points; pixels are -1e9 behind the camera."""
    seen = points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    front = seen[:, 2] > 1e-9
    flat = seen[:, :2] / np.where(front, seen[:, 2], 1.0)[:, None]
    pixels = flat @ camera.K[:2, :2].T + camera.K[:2, 2]
    return np.where(front[:, None], pixels, -1e9), seen


def pixel_motion(camera: Camera, seen: Float64, free: int) -> Float64:
    """How the pixels of points move with the camera's numbers.

    Parameters
    ----------
    camera : Camera
    seen : (P, 3)
        Camera coordinates, z > 0.
    free : int
        FREE_CENTERED or FREE_ALL.

    Returns
    -------
    (P, 2, free)
        Derivative of x and y, in pixels, with respect to the step of `moved`.
    """
    fx, fy = camera.K[0, 0], camera.K[1, 1]
    inverse = 1.0 / seen[:, 2]
    u, v = seen[:, 0] * inverse, seen[:, 1] * inverse
    motion = np.zeros((len(seen), 2, free))
    motion[:, 0, 0], motion[:, 1, 0] = -fx * u * v, -fy * (1.0 + v * v)
    motion[:, 0, 1], motion[:, 1, 1] = fx * (1.0 + u * u), fy * u * v
    motion[:, 0, 2], motion[:, 1, 2] = -fx * v, fy * u
    motion[:, 0, 3], motion[:, 1, 4] = fx * inverse, fy * inverse
    motion[:, 0, 5], motion[:, 1, 5] = -fx * u * inverse, -fy * v * inverse
    motion[:, 0, 6], motion[:, 1, 6] = fx * u, fy * v
    if free == FREE_ALL:
        motion[:, 0, 7], motion[:, 1, 8] = fx, fy
    return motion


@dataclass(frozen=True)
class _Loss:
    """Cauchy loss of a pixel distance."""

    pixels: float

    def weight(self, distance: Float64) -> Float64:
        return np.asarray(1.0 / (1.0 + np.square(distance / self.pixels)))

    def total(self, distance: Float64) -> float:
        return float(np.log1p(np.square(distance / self.pixels)).sum())


def fit_pose(
    camera: Camera, points: Float64, pixels: Float64, *, free: int, loss_pixels: float, rounds: int = 15
) -> Camera:
    """Levenberg-Marquardt on the robust distance between projected and seen points.

    Parameters
    ----------
    camera : Camera
        Start.
    points : (P, 3)
        World coordinates.
    pixels : (P, 2)
        Where they are seen.
    free : int
        FREE_CENTERED or FREE_ALL.
    loss_pixels : float
        Scale of the Cauchy loss.
    rounds : int

    Returns
    -------
    Camera
        Never worse than the start.
    """
    loss, damping = _Loss(loss_pixels), 1e-3
    # A weak pull keeps what the points cannot tell: focal length and principal point.
    prior = np.zeros(free)
    prior[6] = 1.0
    prior[7:] = 10.0
    projected, seen = project(camera, points)
    error = pixels - projected
    cost = loss.total(np.linalg.norm(error, axis=1))
    for _ in range(rounds):
        ahead = seen[:, 2] > 1e-9
        weight = loss.weight(np.linalg.norm(error[ahead], axis=1))
        motion = pixel_motion(camera, seen[ahead], free)
        normal = np.einsum("pik,p,pil->kl", motion, weight, motion)
        gradient = np.einsum("pik,p,pi->k", motion, weight, error[ahead])
        damped = normal + np.diag(prior + damping * np.diag(normal) + 1e-12)
        trial = moved(camera, np.linalg.solve(damped, gradient))
        trial_projected, trial_seen = project(trial, points)
        trial_error = pixels - trial_projected
        trial_cost = loss.total(np.linalg.norm(trial_error, axis=1))
        if trial_cost < cost:
            settled = cost - trial_cost < 1e-4 * cost
            camera, seen, error, cost = trial, trial_seen, trial_error, trial_cost
            damping = max(damping / 5.0, 1e-9)
            if settled:
                break
        else:
            damping *= 10.0
            if damping > 1e6:
                break
    return camera
