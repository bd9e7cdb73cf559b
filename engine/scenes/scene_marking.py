"""Scenes that are not plain Gaussians, marked as what they are. Apart from `scene_files`: who only reads need not
load what marks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from engine.errors import InputError
from engine.flows.embed.embedding import Embedding
from engine.flows.embed.profiles import Auto, Settings
from engine.scenes.clip_marking import embed_moving
from engine.scenes.codebook_marking import embed_codebook
from engine.scenes.codebook_model import CodebookModel
from engine.scenes.frame_folders import FrameSequence
from engine.scenes.scene_files import Loaded, Scene
from engine.scenes.spacetime import SpacetimeModel
from engine.watermark.keys import OwnerKey

__all__ = ["embed_variant"]


def embed_variant(
    loaded: Loaded, key: OwnerKey, copies: Sequence[str] = ("",), *, config: Settings | None = None, **request: Any
) -> Iterator[tuple[Scene, Embedding]]:
    """Mark a clip or a model in codebooks as what it is, for each of these recipients: the marked scene, of the same
    kind, and its embedding. Plain Gaussians are the matter of `engine.flows.embed.embedding.embed_copies`.

    The `request` is that of `engine.flows.embed.embedding.embed`, whose errors are raised. InputError where the
    settings were to be chosen by rehearsal.
    """
    scene = loaded.scene
    if isinstance(config, Auto):
        raise InputError(f"profile 'auto' does not rehearse a scene of this kind ({loaded.format}): name a profile")
    for copy in copies:
        if isinstance(scene, SpacetimeModel | FrameSequence):
            yield embed_moving(scene, key, config=config, copy=copy, **request)
        elif isinstance(scene, CodebookModel):
            yield embed_codebook(scene, key, config=config, copy=copy, **request)
