"""Closed-form deformations of a whole model: bend, twist, squash, each with its analytic gradient.

Every deformation is a map of the body's own coordinates (h along its axis, v and w across it, scene units, zero
in its middle). It acts on the body's length, -length/2 <= h <= length/2; what lies beyond moves rigidly with the
end. Barr, "Global and local deformations of solid primitives", SIGGRAPH 1984.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.lab.sim.vectors import check_triple
from engine.model import Float64, GaussianModel

REACH = 2.0  # Gaussians within this many robust radii of the center say how long the body is
END = 0.01  # share of them beyond each end

PointMap = Callable[[Float64, float, float], tuple[Float64, Float64]]
"""(N, 3) coordinates h, v, w, the body's length and the strength to the deformed ones and the gradients (N, 3, 3)."""


@dataclass(frozen=True, eq=False)
class Axes:
    """A body's own frame."""

    center: Float64  # (3,) middle of the body, scene units
    frame: Float64  # (3, 3) proper rotation; rows are the directions of h, v, w
    length: float  # of the body along h, scene units


def longest_axis(model: GaussianModel, toward: npt.ArrayLike | None = None) -> Axes:
    """The body's frame: h along the coordinate axis in which it is longest; 98 % of the Gaussians nearby are in it.

    `toward` is the direction of v, of which the part across the axis counts, by default the next coordinate axis.
    InputError if the model is empty, or that direction is not finite, zero or along the axis.
    """
    from engine.flows.views.camera_rig import measure_extent

    if len(model) == 0:
        raise InputError("a deformation needs a model that is not empty")
    extent = measure_extent(model)
    longest = int(np.argmax(extent.axes))
    h, v = np.eye(3)[longest], np.eye(3)[(longest + 1) % 3] if toward is None else check_triple(toward, "direction")
    across = v - (v @ h) * h
    if not np.linalg.norm(across) > 1e-9 * np.linalg.norm(v):
        raise InputError(f"direction {v} does not lie across the axis {h}")
    v = across / np.linalg.norm(across)
    offsets = model.means.astype(np.float64) - extent.center
    near = np.linalg.norm(offsets, axis=1) <= REACH * extent.radius
    low, high = np.quantile(offsets[near] @ h, [END, 1.0 - END])
    center = extent.center + 0.5 * (low + high) * h
    return Axes(center, np.stack([h, v, np.cross(h, v)]), max(float(high - low), 1e-6 * extent.radius))


def bend(model: GaussianModel, degrees: float, *, toward: npt.ArrayLike | None = None) -> GaussianModel:
    """Bend the body to an arc; its ends then stand at `degrees` to each other.

    The middle stays where it is, the neutral fibre keeps its length. For the body's length and where it bends to see
    `longest_axis`.
    """
    return _deform(model, bend_points, _radians(degrees), toward)


def twist(model: GaussianModel, degrees: float) -> GaussianModel:
    """Turn the two ends of the body against each other by `degrees` about its axis; the middle stays as it is."""
    return _deform(model, twist_points, _radians(degrees))


def squash(model: GaussianModel, share: float) -> GaussianModel:
    """Press the body together along its axis by `share` of its length, [0, 1); its middle bulges, its volume stays."""
    if not 0 <= share < 1:
        raise InputError(f"a squash takes a share of the length in [0, 1), got {share}")
    return _deform(model, barrel_points, 1.0 - share)


def bend_points(points: Float64, length: float, angle: float) -> tuple[Float64, Float64]:
    """Barr's bend towards +v by `angle` radians over the length: (N, 3) points, (N, 3, 3) gradients."""
    h, v, w = points.T
    inside = np.abs(h) < 0.5 * length
    clipped = np.clip(h, -0.5 * length, 0.5 * length)
    turn = angle / length * clipped
    c, s = np.cos(turn), np.sin(turn)
    beyond = h - clipped
    # Center of curvature at v = length / angle; the sine and versed sine over the angle stay finite without one.
    arc = clipped * np.sinc(turn / np.pi)  # sin(turn) / curvature
    rise = 0.5 * clipped * turn * np.sinc(0.5 * turn / np.pi) ** 2  # (1 - cos(turn)) / curvature
    moved = np.stack([arc - s * v + c * beyond, rise + c * v + s * beyond, w], axis=-1)
    along = np.where(inside, 1.0 - angle / length * v, 1.0)
    gradients = np.zeros((len(points), 3, 3))
    gradients[:, 0, 0], gradients[:, 0, 1] = c * along, -s
    gradients[:, 1, 0], gradients[:, 1, 1] = s * along, c
    gradients[:, 2, 2] = 1.0
    return moved, gradients


def twist_points(points: Float64, length: float, angle: float) -> tuple[Float64, Float64]:
    """Twist about h by `angle` radians over the length: (N, 3) points, (N, 3, 3) gradients."""
    h, v, w = points.T
    rate = np.where(np.abs(h) < 0.5 * length, angle / length, 0.0)
    turn = angle / length * np.clip(h, -0.5 * length, 0.5 * length)
    c, s = np.cos(turn), np.sin(turn)
    moved = np.stack([h, c * v - s * w, s * v + c * w], axis=-1)
    gradients = np.zeros((len(points), 3, 3))
    gradients[:, 0, 0] = 1.0
    gradients[:, 1] = np.stack([-rate * moved[:, 2], c, -s], axis=-1)
    gradients[:, 2] = np.stack([rate * moved[:, 1], s, c], axis=-1)
    return moved, gradients


def barrel_points(points: Float64, length: float, factor: float) -> tuple[Float64, Float64]:
    """Length times `factor`, widths times 1 + b (1 - u^2)^2 with u from -1 to 1 along h, and b such that the
    volume of a cylinder stays: (N, 3) points, (N, 3, 3) gradients."""
    h, v, w = points.T
    half = 0.5 * length
    inside = np.abs(h) < half
    u = np.clip(h / half, -1.0, 1.0)
    # Mean of (1 + b q)^2 over u is 1 + 16/15 b + 128/315 b^2, and must be 1 / factor.
    a2, a1, a0 = 128 / 315, 16 / 15, 1.0 - 1.0 / factor
    b = (-a1 + np.sqrt(a1 * a1 - 4 * a2 * a0)) / (2 * a2)
    width = 1.0 + b * (1.0 - u * u) ** 2
    slope = np.where(inside, -4.0 * b * u * (1.0 - u * u) / half, 0.0)
    moved = np.stack([h + (factor - 1.0) * half * u, width * v, width * w], axis=-1)
    gradients = np.zeros((len(points), 3, 3))
    gradients[:, 0, 0] = np.where(inside, factor, 1.0)
    gradients[:, 1, 0], gradients[:, 1, 1] = slope * v, width
    gradients[:, 2, 0], gradients[:, 2, 2] = slope * w, width
    return moved, gradients


def _deform(
    model: GaussianModel, points_map: PointMap, strength: float, toward: npt.ArrayLike | None = None
) -> GaussianModel:
    from engine.lab.sim.physics.deforming import deform_model  # kernels: the list of attacks only passes by

    axes = longest_axis(model, toward)
    local = (model.means.astype(np.float64) - axes.center) @ axes.frame.T  # (N, 3) h, v, w
    moved, gradients = points_map(local, axes.length, strength)  # (N, 3), (N, 3, 3)
    means = moved @ axes.frame + axes.center
    return deform_model(model, means.astype(np.float32), axes.frame.T @ gradients @ axes.frame)


def _radians(degrees: float) -> float:
    if not np.isfinite(degrees):
        raise InputError(f"the angle of a deformation must be finite, got {degrees}")
    return float(np.radians(degrees))
