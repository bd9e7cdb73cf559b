"""Models in codebooks made of trained ones."""

from collections.abc import Mapping

import numpy as np

from engine.compress.hvq import HvqConfig, learn_residual_stage
from engine.errors import InputError
from engine.model import GaussianModel
from engine.scenes.codebook_model import GROUPS, CodebookModel

__all__ = ["make_codebook"]

CODES = {"dc": 4096, "sh": 4096, "scale": 4096, "rot": 4096}
"""Codes of each group by default: the smaller of the paper's settings."""


def make_codebook(model: GaussianModel, codes: Mapping[str, int] | None = None, *, seed: int = 0) -> CodebookModel:
    """Quantise a trained model by k-means, each group to so many `codes` (`CODES` by default); others stay plain.

    The published system learns its codebooks while the model trains; here a finished model is quantised, which costs
    more quality. Results must say so.
    """
    codes = dict(CODES if codes is None else codes)
    if not codes:
        raise InputError("no group was given to quantise")
    for name, count in codes.items():
        if name not in GROUPS or count < 1:
            raise InputError(f"cannot quantise {name!r} to {count} codes; there are {', '.join(GROUPS)}")
    flat = model.sh.reshape(len(model), -1)
    groups = {
        "xyz": model.means,
        "dc": flat[:, :3],
        "sh": flat[:, 3:],
        "scale": model.log_scales,
        "rot": model.quats * np.where(model.quats[:, :1] < 0, np.float32(-1), np.float32(1)),
    }
    plain = {"opacity": model.opacity_logits[:, None]}
    centers, indices = {}, {}
    for name, values in groups.items():
        if name not in codes or values.shape[1] == 0:
            plain[name] = np.ascontiguousarray(values)
            continue
        stage = learn_residual_stage(np.ascontiguousarray(values), np.ones(len(model)), codes[name], HvqConfig(), seed)
        centers[name], indices[name] = stage.codebook, stage.labels
    bits = max((len(book) - 1).bit_length() for book in centers.values())
    return CodebookModel(plain, centers, indices, max(bits, 1))
