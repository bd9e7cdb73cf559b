"""Levels of detail: fewer Gaussians for far views, all from one ranking by what each contributes; and half precision.

Leaving Gaussian i out costs about sum w_i^2 in squared error (w = alpha T, its blending weights): that is the rank.
What is left out is merged into its nearest survivor with the moments of both, weighted by opacity times area, as
in Hierarchical 3D Gaussians (Kerbl et al. 2024, equation 6), or dropped.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.flows.views.camera_rig import make_rig
from engine.flows.views.view_set import worst_psnr_against
from engine.lab.sim.capture.capture_kernels import principal_axes
from engine.model import ATTRIBUTES, Camera, Float64, GaussianModel, Int32
from engine.numerics.gaussians import flatten
from engine.raster import prepare_view, render

VIEWS, VIEW_SIZE = 12, 400  # of the rig around a model that comes without cameras; pixels

REACH = 3.0
"""A Gaussian is merged into a survivor no farther than so many of both's largest standard deviations together."""

LEAST_OPAQUE, MOST_OPAQUE = 1e-4, 0.99

_STEPS = 12  # 2^-12 of the Gaussians: finer than any view shows


@dataclass(frozen=True, eq=False)
class LevelOfDetail:
    """A model with fewer Gaussians, and which row of the full model each of them is, or was merged into.

    `psnr_db` is that of the worst view, against the full model.
    """

    model: GaussianModel
    kept: Int32
    psnr_db: float


def rank_by_weight(model: GaussianModel, cameras: Sequence[Camera]) -> Float64:
    """(N,) sum over views and pixels of squared blending weights; 0 for what no view shows."""
    total = np.zeros(len(model))
    for camera in cameras:
        total += prepare_view(model, camera).weights()[1]
    return total


def reduce_to(model: GaussianModel, ranking: Float64, count: int, *, merge: bool = True) -> tuple[GaussianModel, Int32]:
    """The model in `count` (1 to N) Gaussians, in the old order, and their rows in the full model.

    The larger in the ranking (N,), the sooner kept. The others are merged into the nearest survivor where one is near,
    or dropped.
    """
    if np.shape(ranking) != (len(model),):
        raise InputError(f"ranking has shape {np.shape(ranking)}, expected ({len(model)},)")
    if not 1 <= count <= len(model):
        raise InputError(f"a level of {count} Gaussians of {len(model)}: expected 1 to {len(model)}")
    order = np.argsort(-np.asarray(ranking), kind="stable")
    kept = np.sort(order[:count]).astype(np.int32)
    if not merge or count == len(model):
        return model.take(kept), kept
    seen = order[count:][np.asarray(ranking)[order[count:]] > 0.0]
    return _merged(model, kept, np.sort(seen)), kept


def levels_of_detail(
    model: GaussianModel,
    shares: Sequence[float] = (0.5, 0.25, 0.1),
    *,
    cameras: Sequence[Camera] | None = None,
    merge: bool = True,
) -> list[LevelOfDetail]:
    """Several levels from one ranking, in the order of the shares of the Gaussians, each in (0, 1].

    The cameras are the views to rank by and to compare; a rig around the model where not given.
    """
    for share in shares:
        if not 0.0 < share <= 1.0:
            raise InputError(f"a level of {share} of the Gaussians: expected a share in (0, 1]")
    ranking, worst = _ranked(model, cameras)
    levels = []
    for share in shares:
        level, kept = reduce_to(model, ranking, max(1, round(share * len(model))), merge=merge)
        levels.append(LevelOfDetail(level, kept, worst(level)))
    return levels


def level_of_quality(
    model: GaussianModel, psnr_db: float, *, cameras: Sequence[Camera] | None = None, merge: bool = True
) -> LevelOfDetail:
    """The smallest level whose worst view is still that near to the full model (by bisection); else the full model."""
    if not np.isfinite(psnr_db):
        raise InputError(f"psnr_db is {psnr_db}, expected a number of dB")
    ranking, worst = _ranked(model, cameras)
    best = LevelOfDetail(model, np.arange(len(model), dtype=np.int32), float("inf"))
    low, high = 0, len(model)
    for _ in range(_STEPS):
        middle = (low + high) // 2
        if middle == low:
            break
        level, kept = reduce_to(model, ranking, middle, merge=merge)
        quality = worst(level)
        if quality >= psnr_db:
            best, high = LevelOfDetail(level, kept, quality), middle
        else:
            low = middle
    return best


def _ranked(model: GaussianModel, cameras: Sequence[Camera] | None) -> tuple[Float64, Callable[[GaussianModel], float]]:
    """The ranking of the Gaussians, and the measure of a level: PSNR of its worst view."""
    if len(model) == 0:
        raise InputError("a model without Gaussians has no levels of detail")
    cameras = cameras or make_rig(model, VIEWS, VIEW_SIZE, VIEW_SIZE)
    return rank_by_weight(model, cameras), worst_psnr_against([render(model, c) for c in cameras], cameras)


def _merged(model: GaussianModel, kept: Int32, others: npt.NDArray[np.int64]) -> GaussianModel:
    """The survivors with the moments of themselves and of the others near them."""
    from scipy.spatial import cKDTree  # costs 0.2 s, and the command line only passes by

    from engine.numerics.gaussians import covariances
    from engine.numerics.similarity import rotation_to_quaternion

    result = model.take(kept)  # arrays of its own
    distance, into = cKDTree(result.means).query(model.means[others])
    largest = np.exp(model.log_scales.max(axis=1).astype(np.float64))
    near = distance <= REACH * (largest[others] + largest[kept[into]])
    others, into = others[near], into[near]
    if len(others) == 0:
        return result
    n = len(kept)
    rows = np.concatenate([kept, others])
    group = np.concatenate([np.arange(n), into])
    area = np.exp(np.sort(model.log_scales[rows].astype(np.float64), axis=1)[:, 1:].sum(axis=1))
    weight = model.opacities[rows].astype(np.float64) * area
    total = np.bincount(group, weight, n)
    share = weight / total[group]

    def mean(values: npt.NDArray[np.float64]) -> Float64:
        flat = values.reshape(len(values), -1)
        columns = [np.bincount(group, share * column, n) for column in flat.T]
        return np.asarray(np.stack(columns, axis=1), dtype=np.float64).reshape(n, *values.shape[1:])

    home = result.means.astype(np.float64)  # offsets from it: no digits are lost far from zero
    offset = model.means[rows].astype(np.float64) - home[group]
    center = mean(offset)
    gap = offset - center[group]
    sigma = mean(covariances(model.take(rows)) + gap[:, :, None] * gap[:, None, :])
    touched = np.flatnonzero(np.bincount(into, minlength=n))  # the others keep their bits
    values, vectors = principal_axes(sigma[touched])
    values = np.maximum(values, 1e-30)  # rounding may leave a variance below 0
    opacity = total[touched] / np.sqrt(values[:, 0] * values[:, 1])
    opacity = np.clip(opacity, LEAST_OPAQUE, MOST_OPAQUE)
    result.means[touched] = home[touched] + center[touched]
    result.log_scales[touched] = 0.5 * np.log(values)
    result.quats[touched] = rotation_to_quaternion(vectors)
    result.opacity_logits[touched] = np.log(opacity / (1.0 - opacity))
    result.sh[touched] = mean(model.sh[rows].astype(np.float64))[touched]
    return flatten(result) if model.is_flat else result


_LARGEST = float(np.finfo(np.float16).max)


def half_precision(model: GaussianModel) -> GaussianModel:
    """Every value rounded to float16 and back, quaternions brought to unit length again.

    No file format read here holds half floats (SPZ and SOG quantize in their own way): this is what happens in graphics
    memory, and in files of viewers that dump it. Centers keep 11 bits, so that a scene far from its origin shows steps.
    InputError if a center or a coefficient is too large for float16 (65,504).
    """
    for name in ("means", "sh"):
        array = getattr(model, name)
        rows = np.flatnonzero((np.abs(array) > _LARGEST).reshape(len(array), -1).any(axis=1))
        if len(rows):
            raise InputError(f"{name}: row {rows[0]} is too large for float16: {array[rows[0]].tolist()}")
    half = model.with_(**{name: getattr(model, name).astype(np.float16) for name in ATTRIBUTES})
    quats = half.quats.astype(np.float64)
    return half.with_(quats=quats / np.linalg.norm(quats, axis=1, keepdims=True))
