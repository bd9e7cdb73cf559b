"""Perception-aware pruning under a quality budget (Eq 5, DESIGN 4.2): no more model than the scene needs.

Instead of a fixed ratio, the base threshold is bisected until the worst view of the pruned model is as far from
the original renders as the owner's budget allows.

Near-duplicate Gaussians are merged first, by an anisotropic (Mahalanobis) distance.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from engine.compress.cells import split_cells
from engine.compress.config import CONFIG
from engine.compress.impact import ranks
from engine.errors import InputError
from engine.model import Bool, Float32, Float64, GaussianModel, Int32
from engine.numerics.gaussians import covariances, flatten


@dataclass(frozen=True)
class PruneConfig:
    """Knobs of pruning."""

    # Wanted PSNR of the pruned model's worst view against the original renders; None leaves the count alone
    budget_db: float | None = None
    # Aggressiveness of Eq 5. The paper's 0.2 leaves 1 to 6 % more Gaussians at the same PSNR than 0 does.
    gamma: float = 0.0
    clusters: int = 256  # spatial clusters with a threshold of their own
    # Squared Mahalanobis distance below which near-duplicates are merged; 0 merges nothing
    merge_distance: float = 0.05
    # What Gaussians are ranked by: "error" (sum of w^2, the squared error of leaving one out) or "paper" (Eq 4). Eq 4
    # calls smooth, isolated Gaussians worthless; on a captured pot it costs 15 dB at 20 % pruned.
    rank: str = "error"
    sh_degree: int = 3  # with a budget: harmonics beyond this degree go first
    steps: int = 12  # most candidates rendered
    tolerance_db: float = 0.15  # how close to the budget is close enough (never below it)
    recover: bool = True  # what is left is fitted to the original's renders (`recovery`), so that more can go


@dataclass(frozen=True, eq=False)
class Pruned:
    """The pruned model, `kept` (n,) original row of each of its Gaussians, and its worst view's PSNR."""

    model: GaussianModel
    kept: Int32
    psnr_db: float
    merged: int


def adaptive_keep(rank: Float64, clusters: Int32, tau_base: float, gamma: float) -> Bool:
    """(N,) Eq 5: keep what lies above tau = tau_base + gamma * (fraction of its cluster below tau_base).

    Impact enters as its rank (N,) in (0, 1], so that thresholds are fractions of the scene whatever its units.
    """
    below = np.bincount(clusters, rank < tau_base) / np.maximum(np.bincount(clusters), 1)
    tau = tau_base + gamma * below  # a cluster that is mostly redundant is cut harder
    return np.asarray(rank >= tau[clusters])


def prune_at(
    model: GaussianModel, impact: Float64, tau_base: float, radius: float, config: PruneConfig
) -> tuple[GaussianModel, Int32, int]:
    """Eq 5 once, as the paper runs it: at a given threshold, whatever the pictures then look like; then merging.

    Gives the model, the original row (n,) of each of its Gaussians, and how many were merged. InputError unless
    `tau_base` lies below 1 and leaves something.

    Parameters
    ----------
    impact : (N,) float64
        What to rank by.
    tau_base : float
        As a fraction of the ranking.
    radius : float
        Scene radius, for the clusters.
    """
    keep = adaptive_keep(ranks(impact), _clusters(model, radius, config), tau_base, config.gamma)
    if not keep.any():
        raise InputError(f"a threshold of {tau_base} with gamma {config.gamma} prunes everything")
    rows = np.flatnonzero(keep).astype(np.int32)
    candidate = model.take(keep)
    if config.merge_distance <= 0:
        return candidate, rows, 0
    merged, kept, _ = merge_duplicates(candidate, config.merge_distance)
    return merged, rows[kept], len(candidate) - len(merged)


def _clusters(model: GaussianModel, radius: float, config: PruneConfig) -> Int32:
    """(N,) spatial cluster of each Gaussian."""
    features = (model.means / radius).astype(np.float32)
    return split_cells(features, np.ones(len(model)), min(config.clusters, max(1, len(model) // 64)))


def prune(
    model: GaussianModel,
    impact: Float64,
    worst_psnr: Callable[[GaussianModel], float],
    radius: float,
    config: PruneConfig,
) -> Pruned:
    """Remove what the budget says is not needed; rows keep their order. With `budget_db=None` the model itself.

    Parameters
    ----------
    impact : (N,) float64
        What to rank by.
    worst_psnr : callable
        Worst view's PSNR of a candidate against the original renders, dB.
    radius : float
        Scene radius, for the clusters.
    """
    n = len(model)
    everything = np.arange(n, dtype=np.int32)
    if config.budget_db is None or n < 16:
        return Pruned(model, everything, float("inf"), 0)
    goal = config.budget_db
    base, rows, impact = _merge_if_cheap(model, impact, worst_psnr, config)
    rank, clusters = ranks(impact), _clusters(base, radius, config)
    best = Pruned(base, rows, worst_psnr(base), n - len(base))
    low, psnr_low = 0.0, min(best.psnr_db, goal + 40.0)
    high, psnr_high = 0.98, goal - 25.0  # nothing much is left there
    for _ in range(config.steps):
        if best.psnr_db - goal < config.tolerance_db:
            break
        # PSNR falls about linearly: aim just above the goal, but always cut the bracket by an eighth.
        share = (psnr_low - goal - 0.5 * config.tolerance_db) / max(psnr_low - psnr_high, 1e-9)
        tau = low + min(max(share, 0.125), 0.875) * (high - low)
        candidate = base.take(keep := adaptive_keep(rank, clusters, tau, config.gamma))
        psnr = worst_psnr(candidate) if len(candidate) else 0.0
        if psnr >= goal:
            low, psnr_low, best = tau, psnr, Pruned(candidate, rows[keep], psnr, n - len(base))
        else:
            high, psnr_high = tau, psnr
    return best


def _merge_if_cheap(
    model: GaussianModel, impact: Float64, worst_psnr: Callable[[GaussianModel], float], config: PruneConfig
) -> tuple[GaussianModel, Int32, Float64]:
    """Merge near-duplicates first, unless that alone eats a third of the budget's error."""
    rows = np.arange(len(model), dtype=np.int32)
    if config.merge_distance <= 0 or config.budget_db is None:
        return model, rows, impact
    candidate, kept, partner = merge_duplicates(model, config.merge_distance)
    if len(candidate) == len(model) or worst_psnr(candidate) < config.budget_db + 5.0:
        return model, rows, impact
    summed = impact.copy()
    np.add.at(summed, kept[partner >= 0], impact[partner[partner >= 0]])
    return candidate, kept, summed[kept]


def drop_unseen_bands(
    model: GaussianModel, curvature: Float32, pixels: int, error_budget: float
) -> tuple[GaussianModel, int]:
    """Zero the SH bands, per Gaussian, that no view needs; also gives how many coefficients (triples) that were.

    With H (N, K) of `sh_curvature`, dropping band l of Gaussian i costs sum_m H_lm sh_lm^2, to second order. The budget
    is the mean squared error that may be spent per channel of all views' pixels together.
    """
    if model.sh_degree == 0:
        return model, 0
    cost = curvature * (model.sh.astype(np.float32) ** 2).sum(axis=2)  # (N, K)
    bands = [cost[:, degree**2 : (degree + 1) ** 2].sum(axis=1) for degree in range(1, model.sh_degree + 1)]
    flat = np.stack(bands, axis=1)  # (N, degree)
    order = np.argsort(flat, axis=None, kind="stable")
    # Neighbouring errors add up coherently (Gaussians overlap): allow a tenth of the second-order estimate.
    affordable = np.cumsum(flat.reshape(-1)[order].astype(np.float64)) <= 0.1 * error_budget * pixels * 3
    drop = np.zeros(flat.shape, dtype=bool)
    drop.reshape(-1)[order[affordable]] = True
    sh = model.sh.copy()
    dropped = 0
    for degree in range(1, model.sh_degree + 1):
        band = slice(degree**2, (degree + 1) ** 2)
        dropped += int((sh[drop[:, degree - 1], band] != 0).any(axis=2).sum())
        sh[drop[:, degree - 1], band] = 0.0
    return model.with_(sh=sh), dropped


def merge_duplicates(model: GaussianModel, distance: float) -> tuple[GaussianModel, Int32, Int32]:
    """Merge mutual nearest neighbours that are one blob written twice.

    They lie within a squared Mahalanobis `distance`, (mu_i - mu_j)^T ((S_i + S_j) / 2)^-1 (mu_i - mu_j).

    Gives the survivors in their old order (a merged pair has the pair's first two moments, and its joint opacity), the
    old row of each (n,), and the old row of the Gaussian merged into each (n,), or -1.
    """
    n = len(model)
    rows = np.arange(n, dtype=np.int32)
    if n < 2:
        return model, rows, np.full(n, -1, np.int32)
    pair = scipy.spatial.cKDTree(model.means).query(model.means, k=2, workers=2)[1]
    nearest = np.where(pair[:, 0] == rows, pair[:, 1], pair[:, 0])  # of exact duplicates either may come first
    first = np.flatnonzero((nearest[nearest] == rows) & (rows < nearest))
    second = nearest[first]
    close = np.abs(model.sh[first, 0] - model.sh[second, 0]).max(axis=1) < CONFIG.color_gap
    first, second = first[close], second[close]
    if len(first) == 0:
        return model, rows, np.full(n, -1, np.int32)
    sigma_a, sigma_b = covariances(model.take(first)), covariances(model.take(second))
    mean = 0.5 * (sigma_a + sigma_b) + 1e-12 * np.trace(sigma_a, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    gap = (model.means[second] - model.means[first]).astype(np.float64)
    mahalanobis = np.einsum("ni,ni->n", gap, np.linalg.solve(mean, gap[:, :, None])[:, :, 0])
    shape = np.linalg.norm(sigma_a - sigma_b, axis=(1, 2)) / np.linalg.norm(mean, axis=(1, 2))
    same = (mahalanobis < distance) & (shape < CONFIG.shape_gap)
    first, second, gap = first[same], second[same], gap[same]
    merged = _merge_pairs(model, first, second, sigma_a[same], sigma_b[same], gap)
    if model.is_flat:  # the gap between two discs of 2DGS does not make them thick
        merged = flatten(merged)
    keep = np.ones(n, dtype=bool)
    keep[second] = False
    partner = np.full(n, -1, dtype=np.int32)
    partner[first] = second
    return merged.take(keep), rows[keep], partner[keep]


def _merge_pairs(
    model: GaussianModel, first: Int32, second: Int32, sigma_a: Float64, sigma_b: Float64, gap: Float64
) -> GaussianModel:
    opacity = model.opacities.astype(np.float64)
    a, b = opacity[first], opacity[second]
    share = (b / (a + b))[:, None]  # the two have nearly one size, so mass is opacity
    mean = model.means[first] + share * gap
    spread = share * (1 - share) * gap
    sigma = (1 - share[:, :, None]) * sigma_a + share[:, :, None] * sigma_b
    sigma += spread[:, :, None] * gap[:, None, :]
    values, vectors = np.linalg.eigh(sigma)
    vectors[np.linalg.det(vectors) < 0, :, 0] *= -1.0
    joint = np.clip(1.0 - (1.0 - a) * (1.0 - b), 1e-6, 1 - 1e-6)
    means, log_scales = model.means.copy(), model.log_scales.copy()
    quats, logits, sh = model.quats.copy(), model.opacity_logits.copy(), model.sh.copy()
    means[first] = mean
    log_scales[first] = 0.5 * np.log(np.maximum(values, 1e-30))
    quats[first] = scipy.spatial.transform.Rotation.from_matrix(vectors).as_quat()[:, [3, 0, 1, 2]]
    logits[first] = np.log(joint / (1 - joint))
    sh[first] = sh[first] + share[:, :, None].astype(np.float32) * (sh[second] - sh[first])
    return model.with_(means=means, log_scales=log_scales, quats=quats, opacity_logits=logits, sh=sh)
