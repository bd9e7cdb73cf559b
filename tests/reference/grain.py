"""Differences of a suspect's Gaussian to its reference, one at a time, from the definitions."""

from itertools import permutations

import numpy as np
from scipy.spatial.transform import Rotation

from engine.model import Float64, GaussianModel, Int32
from engine.numerics.umeyama import Similarity


def rotation_of(quat: Float64) -> Float64:
    """(3, 3) matrix of a quaternion w, x, y, z; its columns are the axes."""
    return Rotation.from_quat(np.roll(quat, -1)).as_matrix()


def differences(reference: GaussianModel, suspect: GaussianModel, fit: Similarity, matches: Int32) -> Float64:
    """(n, 6) centre along the reference's axes in units of `grain.units`, and log scales of the axes that pair up."""
    out = np.zeros((len(suspect), 6))
    for i, j in enumerate(matches):
        if j < 0:
            continue
        axes = rotation_of(reference.quats[j].astype(float))
        scales = np.exp(reference.log_scales[j].astype(float))
        gap = fit.scale * fit.R @ suspect.means[i] + fit.t - reference.means[j]
        out[i, :3] = axes.T @ gap / np.maximum(scales, 0.3 * np.sort(scales)[1])
        cosines = np.abs(axes.T @ fit.R @ rotation_of(suspect.quats[i].astype(float)))
        along = max(permutations(range(3)), key=lambda p: min(cosines[a, p[a]] for a in range(3)))
        if min(cosines[a, along[a]] for a in range(3)) <= 0.8:
            order = np.argsort(suspect.log_scales[i], kind="stable")
            along = tuple(order[np.argsort(np.argsort(reference.log_scales[j], kind="stable"))])
        out[i, 3:] = suspect.log_scales[i][list(along)] + np.log(fit.scale) - reference.log_scales[j]
    return out


def roughened(model: GaussianModel, center: float, scale: float, signs: Float64) -> tuple[Float64, Float64]:
    """Centres and log scales (N, 3) displaced, from the definitions."""
    means, log_scales = model.means.astype(float), model.log_scales.astype(float)
    for i in range(len(model)):
        scales = np.exp(log_scales[i])
        units = np.maximum(scales, 0.3 * np.sort(scales)[1])
        means[i] += rotation_of(model.quats[i].astype(float)) @ (center * signs[i, :3] * units)
        log_scales[i] += np.where(scales < 1e-5 * np.sort(scales)[1], 0.0, scale * signs[i, 3:])
    return means, log_scales
