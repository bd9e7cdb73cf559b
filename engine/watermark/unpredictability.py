"""How badly a code vector's colour can be guessed from those around it (DESIGN 4.5).

A displacement that stands out against its surroundings is seen by people, found by detectors, and removed by
subtracting what is unexpected. So amplitudes follow what the unmarked scene itself leaves unexplained.
"""

import numpy as np
import scipy

from engine.compress.hvq import HvqConfig, group_means, quantize
from engine.model import Float32, Float64, GaussianModel, Int64
from engine.watermark.config import CONFIG


def unexplained(centers: Float64, colors: Float64) -> Float64:
    """(M, 3, 3) mean outer product of what the neighbours' colours leave unexplained.

    Parameters
    ----------
    centers : (M, 3)
        Of the code vectors, any unit.
    colors : (M, 3)
        DC colours.
    """
    count = len(centers)
    if count <= 4:
        return np.zeros((count, 3, 3))
    guessed, near = guess(centers, colors)
    missed = colors - guessed
    around = np.concatenate([np.arange(count)[:, None], near[:, : CONFIG.cells.around - 1]], axis=1)
    return np.asarray(np.einsum("mki,mkj->mij", missed[around], missed[around]) / around.shape[1])


def public_misfit(model: GaussianModel, radius: float) -> Float32:
    """(N, 3) what of each Gaussian's DC color its public cell does not share with the cells around it.

    Anybody can make these cells: their weights are about the area that a Gaussian covers. `radius` is the scene's.
    """
    weights = np.exp(model.log_scales.astype(np.float64).sum(axis=1) * (2.0 / 3.0))
    stage = quantize(model, weights, radius, HvqConfig())[0]
    centers = group_means(model.means, stage.labels, weights).astype(np.float64)
    colors = stage.codebook[:, :3].astype(np.float64)
    return np.asarray((colors - guess(centers, colors)[0])[stage.labels], dtype=np.float32)


def guess(centers: Float64, colors: Float64) -> tuple[Float64, Int64]:
    """(M, 3) what a plane through the neighbours' colours says of each, and the neighbours, (M, k), nearest first.

    Of at least two code vectors, else as in `unexplained`.
    """
    count = len(centers)
    k = min(CONFIG.cells.neighbors + 1, count)
    near = scipy.spatial.cKDTree(centers).query(centers, k=k, workers=2)[1][:, 1:]  # (M, k - 1)
    offset = centers[near] - centers[:, None]
    offset /= np.sqrt(np.square(offset).sum(axis=2).mean(axis=1))[:, None, None] + 1e-300
    design = np.concatenate([offset, np.ones((*near.shape, 1))], axis=2)  # (M, k, 4)
    normal = np.einsum("mki,mkj->mij", design, design) + CONFIG.cells.ridge * np.eye(4)
    return np.linalg.solve(normal, np.einsum("mki,mkc->mic", design, colors[near]))[:, 3], near
