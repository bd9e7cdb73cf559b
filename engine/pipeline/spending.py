"""From a model to what is delivered of it, unmarked; and the ways of spending what an owner allows on a smaller file.

`embed --profile auto --budget DB` leaves the way to the scene: every way keeps DB in the worst key view, against the
original. `choosing` rehearses what each leaves of the mark and takes the smallest file that still shows it. To drop
the residual of colours (`compact`) is no way: at the same fidelity no file was smaller for it (docs/RESULTS.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from engine.compress.hvq import Stage
from engine.formats import encode_model
from engine.model import GaussianModel
from engine.pipeline.delivery import slim_down, unmarked_delivery
from engine.pipeline.groundwork import Groundwork
from engine.pipeline.profiles import EmbedConfig
from engine.pipeline.progress import Clock
from engine.pipeline.scenes import ViewSet

__all__ = ["Delivery", "deliver", "file_bytes", "ways"]

WEIGHED = 50_000
"""Gaussians, evenly taken, by whose bytes a larger model's are told."""


@dataclass(frozen=True, eq=False)
class Delivery:
    """A model as it would be delivered, unmarked, and what it is marked with."""

    settings: EmbedConfig
    ground: Groundwork  # of the pruned model
    model: GaussianModel
    stages: tuple[Stage, ...]  # public cells, and what refines them
    views: ViewSet  # of `model`
    pruned: dict[str, Any]  # for the report


def deliver(original: Groundwork, settings: EmbedConfig, clock: Clock) -> Delivery:
    """Prune and quantise as the settings say."""
    if (settings.output, settings.quantize) != (original.config.output, original.config.quantize):
        original = replace(original, config=settings)  # other cells, the same looks
    with clock.stage("prune"):
        slim, pruned = slim_down(original.model, original.views, original.impact, original.extent, settings)
    with clock.stage("quantize"):
        ground = original.of(slim, clock)
        model, stages = unmarked_delivery(slim, ground.stages, original.views, ground.impact, settings)
        return Delivery(settings, ground, model, tuple(stages), ground.views_of(model, clock), pruned)


def ways(config: EmbedConfig, allowed_db: float, sh_degree: int) -> Iterator[EmbedConfig]:
    """Settings that spend an allowance on a model of this degree: pruned as it is, or cut to fewer harmonics first."""
    for degree in range(sh_degree + 1):
        yield replace(config, prune=replace(config.prune, budget_db=allowed_db, sh_degree=degree))


def file_bytes(model: GaussianModel, format: str) -> int:
    """Bytes of a file of this model, about: told by a part of it where it is large."""
    part = model.take(np.arange(0, len(model), max(1, len(model) // WEIGHED)))
    return round(len(encode_model(part, format)) * len(model) / len(part))
