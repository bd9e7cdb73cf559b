"""Every kind of scene, marked as what it is. Apart from `scene_files`: who only reads need not load what marks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from engine.errors import InputError
from engine.flows.embed.embedding import Embedding, embed_on_terms
from engine.flows.embed.profiles import Auto
from engine.flows.embed.terms import MarkTerms
from engine.flows.progress import Progress
from engine.model import GaussianModel
from engine.scenes.clip_marking import embed_moving
from engine.scenes.codebook_marking import embed_codebook
from engine.scenes.codebook_model import CodebookModel
from engine.scenes.frame_folders import FrameSequence
from engine.scenes.scene_files import Loaded, Scene
from engine.scenes.spacetime import SpacetimeModel
from engine.watermark.keys import OwnerKey

__all__ = ["embed_scene", "embed_variant"]


def embed_scene(
    loaded: Loaded, key: OwnerKey, copies: Sequence[str], terms: MarkTerms, progress: Progress | None = None
) -> Iterator[tuple[Scene, Embedding]]:
    """Mark a scene for each of these recipients: the marked scene, of the same kind, and its embedding.

    Errors are those of `engine.flows.embed.embedding.embed`.
    """
    if not isinstance(loaded.scene, GaussianModel):
        yield from embed_variant(loaded, key, copies, terms, progress)
        return
    for made in embed_on_terms(loaded.scene, key, copies, terms, original_sha256=loaded.sha256, progress=progress):
        yield made.model, made


def embed_variant(
    loaded: Loaded, key: OwnerKey, copies: Sequence[str], terms: MarkTerms, progress: Progress | None = None
) -> Iterator[tuple[Scene, Embedding]]:
    """`embed_scene` for what is not plain Gaussians, a clip or a model in codebooks.

    InputError where the settings were to be chosen by rehearsal.
    """
    scene, digest = loaded.scene, loaded.sha256
    if isinstance(terms.config, Auto):
        raise InputError(f"profile 'auto' does not rehearse a scene of this kind ({loaded.format}): name a profile")
    for copy in copies:
        if isinstance(scene, SpacetimeModel | FrameSequence):
            yield embed_moving(scene, key, terms, original_sha256=digest, copy=copy, progress=progress)
        elif isinstance(scene, CodebookModel):
            yield embed_codebook(scene, key, terms, original_sha256=digest, copy=copy, progress=progress)
