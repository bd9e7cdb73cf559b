"""Models in codebooks made of trained ones, and marked in their own colour codebook."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from engine.compress.hvq import HvqConfig, learn_residual_stage
from engine.errors import InputError
from engine.flows.embed.embedding import Embedding, embed_on_terms
from engine.flows.embed.terms import MarkTerms
from engine.flows.embed.variant import Variant
from engine.flows.progress import Progress
from engine.model import GaussianModel
from engine.scenes.codebook_model import GROUPS, CodebookModel
from engine.watermark.keys import OwnerKey

__all__ = ["embed_codebook", "make_codebook"]

CODES = {"dc": 4096, "sh": 4096, "scale": 4096, "rot": 4096}
"""Codes of each group where `make_codebook` is not told: the smaller of the paper's settings."""


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


def embed_codebook(
    compressed: CodebookModel,
    key: OwnerKey,
    terms: MarkTerms = MarkTerms(),
    *,
    original_sha256: str,
    copy: str = "",
    progress: Progress | None = None,
) -> tuple[CodebookModel, Embedding]:
    """Mark a model in its own colour codebook: its entries are the mark's code vectors.

    Centres and sizes carry the grain where they are plain; a codebook of them would need an entry a Gaussian.

    Errors are those of `engine.flows.embed.embedding.embed`. The marked model
    has as many codes and the same indices: a file of the same size. InputError if the colours have no codebook.
    """
    if "dc" not in compressed.centers:
        raise InputError("this model's colours are not quantised: mark it as a plain model")
    model, labels = compressed.decode(), compressed.indices["dc"]
    own = Variant(labels=labels, free_centers="xyz" in compressed.plain, free_sizes="scale" in compressed.plain)
    terms = replace(terms, variant=own)
    (result,) = embed_on_terms(model, key, [copy], terms, original_sha256=original_sha256, progress=progress)
    used, member = np.unique(labels, return_index=True)  # all members of a code are displaced alike
    codes = compressed.centers["dc"].copy()  # (M, 3)
    codes[used] = result.model.sh[member, 0]
    free = {
        name: values
        for name, values in (("xyz", result.model.means), ("scale", result.model.log_scales))
        if name in compressed.plain
    }
    return replace(compressed.with_codes("dc", codes), plain={**compressed.plain, **free}), result
