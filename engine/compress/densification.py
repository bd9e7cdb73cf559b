"""Frequency-guided densification: more Gaussians where there is texture, in which a mark is hard to see (the paper).

The paper densifies while it trains. A finished model is densified once: the Gaussians of the greatest W^freq are split.
"""

import numpy as np

from engine.model import Float64, GaussianModel
from engine.numerics.similarity import quaternion_to_rotation

APART = 0.5
"""How far each half moves along the longest axis, in standard deviations of the whole along it."""


def densify(model: GaussianModel, worth: Float64, share: float) -> GaussianModel:
    """The model with a share of its Gaussians, those of the greatest worth (N,), split in two along their longest axis.

    Both halves keep the colour and, together, the first two moments; where they overlap they are as opaque as the
    whole. One half takes the whole's row, the other stands at the end.
    """
    count = round(share * len(model))
    if count == 0:
        return model
    rows = np.sort(np.argsort(-worth, kind="stable")[:count])
    axis = model.log_scales[rows].argmax(axis=1)
    along = quaternion_to_rotation(model.quats[rows])[np.arange(count), :, axis]  # (count, 3)
    step = APART * np.exp(model.log_scales[rows, axis].astype(np.float64))[:, None] * along
    log_scales, logits = model.log_scales.copy(), model.opacity_logits.copy()
    log_scales[rows, axis] += np.float32(0.5 * np.log(1.0 - APART**2))
    clear = np.sqrt(np.maximum(1.0 - model.opacities[rows].astype(np.float64), 1e-12))  # of each half
    logits[rows] = np.log(np.maximum(1.0 - clear, 1e-12) / clear)
    means = model.means.copy()
    means[rows] = model.means[rows] - step
    first = model.with_(means=means, log_scales=log_scales, opacity_logits=logits)
    every = np.concatenate([np.arange(len(model)), rows])
    both = first.take(every)
    means = both.means.copy()
    means[len(model) :] = model.means[rows] + step
    return both.with_(means=means)
