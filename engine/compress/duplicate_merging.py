"""Merging of near-duplicate Gaussians by an anisotropic (Mahalanobis) distance (DESIGN 4.2)."""

import numpy as np
import scipy

from engine.compress.config import CONFIG
from engine.model import Float64, GaussianModel, Int32
from engine.numerics.gaussians import covariances, flatten


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
