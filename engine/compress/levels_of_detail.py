"""Levels of detail: fewer, larger Gaussians in one look, as publishing tools make them.

Each survivor is the sum of those it replaces: their mass, mean and covariance (moment matching), their mean color.
"""

# mypy: allow-untyped-defs

import math

import numpy as np
from scipy.spatial import cKDTree

from engine.compress.config import CONFIG
from engine.kernels.jit import kernel, parallel_kernel, share_of
from engine.model import GaussianModel, Int64
from engine.numerics.gaussians import covariances, merge_groups, surface_mass, volume_mass


def merge_pairs(model: GaussianModel, share: float, *, surface: bool) -> GaussianModel:
    """Merge neighbours pair after pair until this share of the Gaussians is left, in (0, 1].

    With `surface` as SuperSplat's publishing and splat-transform's `--decimate`: mass is opacity times surface, and is
    kept. Without it as NanoGS (Xiong et al. 2026, arXiv 2603.16103): mass is opacity times volume, and light adds up
    as in blending.
    """
    target = max(1, round(share * len(model)))
    while len(model) > target:
        pairs = _pairs(model, len(model) - target, surface=surface)
        group = np.arange(len(model))
        group[pairs[:, 1]] = pairs[:, 0]
        model = merge_groups(model, numbered(group), surface=surface)
    return model


def numbered(first: Int64) -> Int64:
    """(N,) groups numbered from 0, from the first member of each Gaussian's group (N,)."""
    return (np.cumsum(first == np.arange(len(first))) - 1)[first]


def _pairs(model: GaussianModel, wanted: int, *, surface: bool) -> Int64:
    """At most `wanted` disjoint pairs (p, 2) of neighbours, those that lose least by being merged."""
    k = min(CONFIG.neighbors + 1, len(model))
    near = np.asarray(cKDTree(model.means).query(model.means, k=k, workers=2)[1]).reshape(len(model), k)
    mass = surface_mass(model) if surface else volume_mass(model)
    sigma = covariances(model)
    sigma += (CONFIG.thin * np.trace(sigma, axis1=1, axis2=2)[:, None, None] + 1e-300) * np.eye(3)
    means, looks = model.means.astype(np.float64), model.sh.reshape(len(model), -1)
    cost = np.full(near.shape, np.inf)
    merging_costs(means, sigma, mass, looks, near, CONFIG.color_std, cost)
    edges = np.flatnonzero(np.isfinite(cost))
    edges = edges[np.argsort(cost.reshape(-1)[edges], kind="stable")]
    pairs: Int64 = disjoint_pairs(edges // k, near.reshape(-1)[edges], len(model), wanted)
    return pairs


@parallel_kernel(allocates=True)
def merging_costs(means, sigma, mass, looks, near, color_std, out, call):
    """To `out` (n, k) what merging each of n Gaussians with each of its neighbours `near` (n, k) loses; it holds
    infinity, which stays where the neighbour does not come after it.

    Runnalls' bound on the divergence of mixture and merged Gaussian, per mass (IEEE Trans. Aerosp. Electron. Syst. 43,
    2007, equation 18), and the spread of the colours.
    """
    for i in share_of(len(means), call):
        own = math.log(_determinant(sigma[i]))
        joint = np.empty((3, 3))
        for at in range(near.shape[1]):
            j = near[i, at]
            if j <= i:
                continue
            p = mass[i] / (mass[i] + mass[j])
            q = 1.0 - p
            for a in range(3):
                for b in range(3):
                    gap2 = (means[i, a] - means[j, a]) * (means[i, b] - means[j, b])
                    joint[a, b] = p * sigma[i, a, b] + q * sigma[j, a, b] + p * q * gap2
            apart = 0.0
            for c in range(looks.shape[1]):
                apart += (looks[i, c] - looks[j, c]) ** 2
            shape = math.log(_determinant(joint)) - p * own - q * math.log(_determinant(sigma[j]))
            out[i, at] = 0.5 * shape + 0.5 * apart / (color_std * color_std)


@kernel
def _determinant(s):
    minor0 = s[1, 1] * s[2, 2] - s[1, 2] * s[2, 1]
    minor1 = s[1, 0] * s[2, 2] - s[1, 2] * s[2, 0]
    minor2 = s[1, 0] * s[2, 1] - s[1, 1] * s[2, 0]
    return max(s[0, 0] * minor0 - s[0, 1] * minor1 + s[0, 2] * minor2, 1e-300)


@kernel(allocates=True)
def disjoint_pairs(first, second, n, wanted):
    """(p, 2) of the pairs (first, second) in their order, those whose ends no earlier one has; at most `wanted`."""
    taken = np.zeros(n, np.bool_)
    out = np.empty((min(wanted, n // 2), 2), np.int64)
    count = 0
    for e in range(len(first)):
        if count == len(out):
            break
        i, j = first[e], second[e]
        if taken[i] or taken[j]:
            continue
        taken[i] = taken[j] = True
        out[count, 0], out[count, 1] = i, j
        count += 1
    return out[:count]
