"""Attacks that remove, copy or merge Gaussians: which Gaussians there are, not what they are.

All are pure functions `(model, strength, rng) -> model`; survivors keep their order. Merging is that of publishing
tools that make levels of detail (`compress.levels_of_detail`).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.compress.levels_of_detail import merge_pairs, numbered
from engine.errors import InputError
from engine.flows.views.camera_rig import make_rig
from engine.lab.sim.attack import Attacks
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.numerics.gaussians import merge_groups
from engine.numerics.similarity import quaternion_to_rotation

__all__ = ["ATTACKS", "clone", "crop", "impact"]


ATTACKS: Attacks[GaussianModel] = Attacks("model")

_CLONED = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0)
_PRUNED = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95)

CLONE_JITTER = 0.05  # shift of a clone in standard deviations of its Gaussian, along its own axes

IMPACT_VIEWS = 24
IMPACT_SIZE = 256  # views generated where no cameras are given, and their side in pixels


@ATTACKS.add(
    "keep a connected piece about a random Gaussian",
    "kept share",
    0.1,
    (0.9, 0.7, 0.5, 0.3, 0.2, 0.1, 0.05, 0.02, 0.01),
    "(0, 1]",
)
def crop(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """The Gaussians nearest to it."""
    seed = model.means[rng.integers(len(model))]
    distance = np.linalg.norm(model.means.astype(np.float64) - seed, axis=1)
    return model.take(_lowest(distance, max(1, round(strength * len(model)))))


@ATTACKS.as_code("crop", "dropped share of the file's order", 0.1, (0.1, 0.3, 0.5, 0.9), "[0, 1)")
def drop_block(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """GaussianMarker's "crop": drop one contiguous block of the file's order, `strength` of its Gaussians."""
    count = min(round(strength * len(model)), len(model) - 1)
    start = int(rng.integers(len(model) - count + 1))
    return model.take(np.delete(np.arange(len(model)), slice(start, start + count)))


@ATTACKS.add("remove Gaussians at random", "removed share", 0.2, (*_PRUNED, 0.98, 0.99), "[0, 1)")
def prune_random(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    return _prune(model, rng.random(len(model)), strength)


@ATTACKS.add("remove the most transparent Gaussians", "removed share", 0.2, _PRUNED, "[0, 1)")
def prune_opacity(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    return _prune(model, model.opacity_logits, strength)


@ATTACKS.add("remove the Gaussians that weigh least in rendered views", "removed share", 0.2, _PRUNED, "[0, 1)")
def prune_low_impact(
    model: GaussianModel, strength: float, rng: np.random.Generator, *, cameras: Sequence[Camera] | None = None
) -> GaussianModel:
    """As compressors and GSPure do: by the blending weights that `impact` adds up over the cameras' views."""
    return _prune(model, impact(model, cameras, rng), strength)


def impact(model: GaussianModel, cameras: Sequence[Camera] | None, rng: np.random.Generator | None = None) -> Float64:
    """(N,) blending weight alpha * T of each Gaussian, added up over all pixels of all views.

    Without cameras 24 generated views, which `rng` places; InputError where the list of them is empty.
    """
    from engine.raster import prepare_view

    if cameras is None:
        jitter = None if rng is None else rng.random((IMPACT_VIEWS, 4))
        cameras = make_rig(model, IMPACT_VIEWS, IMPACT_SIZE, IMPACT_SIZE, jitter=jitter)
    if not cameras:
        raise InputError("blending weights need at least one camera")
    total = np.zeros(len(model))
    for camera in cameras:
        total += prepare_view(model, camera).weights()[0]
    return total


@ATTACKS.add("duplicate Gaussians", "share split into look-alike pairs", 0.5, _CLONED, "[0, 1]")
def clone(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Split a random share `strength` into pairs that together look like the one they replace.

    Each of a pair gets the opacity 1 - sqrt(1 - o), so that at the center both let as much light through as
    the one did, and the second is moved by a twentieth of its standard deviations. The copies come last.
    """
    chosen = _chosen(model, strength, rng)
    opacity = model.opacity_logits.astype(np.float64)
    # 1 - o' = sqrt(1 - o) in logits: softplus(x) = -log(1 - o) is halved, x' = log(expm1(softplus(x) / 2)).
    half = 0.5 * np.logaddexp(0.0, opacity[chosen])
    opacity[chosen] = half + np.log(-np.expm1(-half))
    thinned = model.with_(opacity_logits=opacity.astype(np.float32))
    steps = CLONE_JITTER * rng.standard_normal((len(chosen), 3)) * np.exp(model.log_scales[chosen])
    moves = np.einsum("nij,nj->ni", quaternion_to_rotation(model.quats[chosen]), steps)
    return _with_copies(thinned, chosen, moves.astype(np.float32))


@ATTACKS.as_code("clone", "share duplicated as it is", 0.5, _CLONED, "[0, 1]")
def clone_plain(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Append exact duplicates of a random share `strength`, opacities as they were: the look gets denser."""
    chosen = _chosen(model, strength, rng)
    return _with_copies(model, chosen, np.zeros((len(chosen), 3), dtype=np.float32))


def _chosen(model: GaussianModel, strength: float, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    return np.sort(rng.permutation(len(model))[: round(strength * len(model))])


def _with_copies(model: GaussianModel, chosen: npt.NDArray[np.int64], moves: Float32) -> GaussianModel:
    both = model.take(np.concatenate([np.arange(len(model)), chosen]))
    means = both.means.copy()
    means[len(model) :] += moves
    return both.with_(means=means)


def _prune(model: GaussianModel, score: npt.NDArray[Any], strength: float) -> GaussianModel:
    """The model without the share of the lowest scores; at least one Gaussian stays."""
    removed = min(round(strength * len(model)), len(model) - 1)
    return model.take(np.delete(np.arange(len(model)), _lowest(score, removed)))


def _lowest(score: npt.NDArray[Any], count: int) -> npt.NDArray[np.int64]:
    """Indices, ascending, of the `count` lowest scores; of equal ones the first."""
    return np.sort(np.argsort(score, kind="stable")[:count])


_KEPT = (0.9, 0.7, 0.5, 0.25, 0.1, 0.05, 0.02)


@ATTACKS.add("merge neighbors, pair after pair", "kept share", 0.25, _KEPT, "(0, 1]")
def merge(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """NanoGS (Xiong et al. 2026, arXiv 2603.16103): mass is opacity times volume, and light adds up as in blending."""
    return merge_pairs(model, strength, surface=False)


@ATTACKS.as_code("merge", "kept share", 0.25, _KEPT, "(0, 1]")
def merge_published(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """SuperSplat's publishing and splat-transform's `--decimate`: mass is opacity times surface, and is kept."""
    return merge_pairs(model, strength, surface=True)


@ATTACKS.add("merge the Gaussians of a voxel, level after level", "kept share", 0.25, _KEPT, "(0, 1]")
def lod(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """The level of a voxel tree (Spark's) that has the share `strength` left: finer Gaussians become one."""
    return merge_voxels(model, strength)


LEVEL_STEP = 1.5
"""Factor between the voxel sizes of two levels."""


def merge_voxels(model: GaussianModel, share: float) -> GaussianModel:
    """The level of a voxel tree (Spark's) that has this share left, in (0, 1]: what is finer than a voxel becomes one.

    Voxels grow by half a level, from the finest Gaussians on. In the last level only as many voxels are merged as the
    share requires, those of the fewest Gaussians first.
    """
    target = max(1, round(share * len(model)))
    size = float(np.quantile(2.0 * np.exp(model.log_scales.max(axis=1)), 0.05))
    size = max(size, 1e-6 * float(np.ptp(model.means, axis=0).max()), 1e-30)
    while len(model) > target:
        fine = np.flatnonzero(2.0 * np.exp(model.log_scales.max(axis=1)) <= size)
        voxels = np.floor(model.means[fine] / size).astype(np.int64)
        _, of, count = np.unique(voxels, axis=0, return_inverse=True, return_counts=True)
        of = of.reshape(-1)
        order = np.argsort(count, kind="stable")
        spared = np.cumsum(count[order] - 1)  # Gaussians fewer after the first so many voxels
        take = order[: int(np.searchsorted(spared, len(model) - target)) + 1]
        merged = np.zeros(len(count), np.bool_)
        merged[take] = True
        first = np.empty(len(count), np.int64)
        first[of[::-1]] = fine[::-1]
        group = np.arange(len(model))
        group[fine] = np.where(merged[of], first[of], fine)
        model = merge_groups(model, numbered(group), surface=True)
        size *= LEVEL_STEP
    return model
