"""Every kind of scene, marked as what it is. Apart from `scene_files`: reading need not load what marks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from engine.errors import InputError
from engine.flows.embed.embedding import Embedding, embed_on_terms
from engine.flows.embed.terms import MarkTerms
from engine.flows.embed.variant import Variant
from engine.flows.progress import Progress
from engine.model import GaussianModel
from engine.scenes.clip_marking import embed_moving
from engine.scenes.codebook_model import CodebookModel
from engine.scenes.frame_folders import FrameSequence
from engine.scenes.scene_files import Loaded, Scene
from engine.scenes.spacetime import SpacetimeModel
from engine.watermark.keys import OwnerKey

__all__ = ["embed_codebook", "embed_scene"]


def embed_scene(
    loaded: Loaded, key: OwnerKey, copies: Sequence[str], terms: MarkTerms, progress: Progress | None = None
) -> Iterator[tuple[Scene, Embedding]]:
    """Mark a scene for each of these recipients: the marked scene, of the same kind, and its embedding.

    Errors are those of `engine.flows.embed.embedding.embed`.
    """
    scene, digest = loaded.scene, loaded.sha256
    if isinstance(scene, GaussianModel):
        for made in embed_on_terms(scene, key, copies, terms, original_sha256=digest, progress=progress):
            yield made.model, made
        return
    for copy in copies:
        if isinstance(scene, SpacetimeModel | FrameSequence):
            yield embed_moving(scene, key, terms, original_sha256=digest, copy=copy, progress=progress)
        elif isinstance(scene, CodebookModel):
            yield embed_codebook(scene, key, terms, original_sha256=digest, copy=copy, progress=progress)


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
