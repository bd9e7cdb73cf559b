"""Levels of detail: fewer Gaussians for far views, all from one ranking by what each contributes.

Leaving Gaussian i out costs about sum w_i^2 in squared error (w = alpha T, its blending weights): that is the rank.
What is left out is merged into its nearest survivor with the moments of both, weighted by opacity times area, as
in Hierarchical 3D Gaussians (Kerbl et al. 2024, equation 6), or dropped.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Camera, Float64, GaussianModel, Int32
from engine.numerics.flattening import flatten
from engine.pipeline.rigs import make_rig
from engine.pipeline.scenes import worst_psnr_against
from engine.raster import prepare_view, render

__all__ = ["LevelOfDetail", "level_of_quality", "levels_of_detail", "rank_by_weight", "reduce_to"]

VIEWS, VIEW_SIZE = 12, 400
"""Of the rig around a model that comes without cameras; pixels."""

REACH = 3.0
"""A Gaussian is merged into a survivor no farther than so many of both's largest standard deviations together."""

MOST_OPAQUE = 0.99

_STEPS = 12  # 2^-12 of the Gaussians: finer than any view tells


@dataclass(frozen=True, eq=False)
class LevelOfDetail:
    """A model with fewer Gaussians.

    Parameters
    ----------
    kept : (n,) int32
        Row of the full model that each of its Gaussians is, or was merged into.
    psnr_db : float
        Of the worst view, against the full model.
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
    """The model in so many Gaussians.

    Parameters
    ----------
    ranking : (N,)
        The larger, the sooner kept.
    count : int
        1 to N.
    merge : bool
        Merge the others into the nearest survivor where one is near, or drop them.

    Returns
    -------
    model : GaussianModel
        In the old order.
    kept : (count,) int32
        Their rows in the full model.

    Raises
    ------
    InputError
        If the count or the shape of the ranking is wrong.
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
    """Several levels from one ranking.

    Parameters
    ----------
    shares : sequence of float
        Parts of the Gaussians, each in (0, 1].
    cameras : sequence of Camera, optional
        Views to rank by and to compare; a rig around the model where not given.
    merge : bool
        See `reduce_to`.

    Returns
    -------
    list of LevelOfDetail
        In the order of the shares.

    Raises
    ------
    InputError
        If the model is empty or a share lies outside its range.
    """
    for share in shares:
        if not 0.0 < share <= 1.0:
            raise InputError(f"a level of {share} of the Gaussians: expected a share in (0, 1]")
    cameras = _cameras(model, cameras)
    ranking = rank_by_weight(model, cameras)
    worst = worst_psnr_against([render(model, camera) for camera in cameras], cameras)
    levels = []
    for share in shares:
        level, kept = reduce_to(model, ranking, max(1, round(share * len(model))), merge=merge)
        levels.append(LevelOfDetail(level, kept, worst(level)))
    return levels


def level_of_quality(
    model: GaussianModel, psnr_db: float, *, cameras: Sequence[Camera] | None = None, merge: bool = True
) -> LevelOfDetail:
    """The smallest level whose worst view is still that near to the full model (by bisection).

    Parameters
    ----------
    psnr_db : float
        Least PSNR, dB.
    cameras, merge
        See `levels_of_detail`.

    Returns
    -------
    LevelOfDetail
        The full model where no smaller level reaches it.

    Raises
    ------
    InputError
        If the model is empty or the PSNR is not finite.
    """
    if not np.isfinite(psnr_db):
        raise InputError(f"psnr_db is {psnr_db}, expected a number of dB")
    cameras = _cameras(model, cameras)
    ranking = rank_by_weight(model, cameras)
    worst = worst_psnr_against([render(model, camera) for camera in cameras], cameras)
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


def _cameras(model: GaussianModel, cameras: Sequence[Camera] | None) -> Sequence[Camera]:
    if len(model) == 0:
        raise InputError("a model without Gaussians has no levels of detail")
    return cameras or make_rig(model, VIEWS, VIEW_SIZE, VIEW_SIZE)


def _merged(model: GaussianModel, kept: Int32, others: npt.NDArray[np.int64]) -> GaussianModel:
    """The survivors with the moments of themselves and of the others near them."""
    from scipy.spatial import cKDTree  # costs 0.2 s, and the command line only passes by

    from engine.compress.merging import covariances
    from engine.numerics.similarity import rotation_to_quaternion

    result = model.take(kept)
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
    values, vectors = np.linalg.eigh(sigma[touched])
    values = np.maximum(values, 1e-30)
    vectors = vectors[:, :, ::-1].copy()  # the shortest axis last, as discs have it
    values = values[:, ::-1]
    vectors[np.linalg.det(vectors) < 0.0, :, 2] *= -1.0
    opacity = total[touched] / np.sqrt(values[:, 0] * values[:, 1])
    opacity = np.clip(opacity, 1e-4, MOST_OPAQUE)
    arrays = {name: getattr(result, name).copy() for name in ("means", "log_scales", "quats", "opacity_logits")}
    arrays["means"][touched] = home[touched] + center[touched]
    arrays["log_scales"][touched] = 0.5 * np.log(values)
    arrays["quats"][touched] = rotation_to_quaternion(vectors)
    arrays["opacity_logits"][touched] = np.log(opacity / (1.0 - opacity))
    sh = result.sh.copy()
    sh[touched] = mean(model.sh[rows].astype(np.float64))[touched]
    merged = result.with_(**arrays, sh=sh)
    return flatten(merged) if model.is_flat else merged
