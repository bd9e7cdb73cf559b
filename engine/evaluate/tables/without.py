"""Steps of the embedding that have no knob, taken out for an ablation through the door that variants use.

- ``uncertainty weights``: stage 0 weighs all Gaussians alike, not by the curvature of the render error.
- ``uncertainty mask``: code vectors that the views are uncertain about are displaced like the others.
- ``uncertainty``: both of these.
- ``svd``: carriers are the RGB axes, not the right singular vectors of the codebook.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from engine.compress.hvq import HvqConfig, Stage, quantize
from engine.compress.impact import Impact, uncertainty
from engine.errors import InputError
from engine.model import SH_C0, Float64, GaussianModel, Int32
from engine.pipeline.rigs import measure_extent
from engine.pipeline.variant import PLAIN, Variant

__all__ = ["STEPS", "without"]

STEPS = ("uncertainty weights", "uncertainty mask", "uncertainty", "svd")


def without(step: str, config: HvqConfig) -> Variant:
    """The variant whose embedding lacks that step; the plain one for an empty name.

    Parameters
    ----------
    step : str
        One of STEPS, or empty.
    config : HvqConfig
        Of the embedding.

    Raises
    ------
    InputError
        If there is no such step.
    """
    if not step:
        return PLAIN
    if step not in STEPS:
        raise InputError(f"no step {step!r} can be taken out; there are {', '.join(STEPS)}")
    return _Without(step=step, config=config)


@dataclass(frozen=True, eq=False)
class _Without(Variant):
    step: str = ""
    config: HvqConfig = field(default_factory=HvqConfig)
    seen: list[Int32] = field(default_factory=list)

    def own_stages(self, model: GaussianModel, weights: Float64) -> tuple[Stage, ...]:
        if self.step in ("uncertainty weights", "uncertainty"):
            weights = np.ones(len(model))
        stages = quantize(model, weights, measure_extent(model).radius, self.config)
        self.seen.append(stages[0].labels)
        return _on_rgb_axes(stages) if self.step == "svd" else stages

    def emphasis_on(self, impact: Impact) -> Float64 | None:
        if self.step not in ("uncertainty mask", "uncertainty"):
            return None
        labels = self.seen[-1]
        return np.asarray(1.0 / doubt(labels, impact))[labels]


def doubt(labels: Int32, impact: Impact) -> Float64:
    """(M,) the planner's factor for uncertainty on each cell; 1 where nothing was seen.

    A copy of what `engine.watermark.planning` multiplies in, to be divided out; a test holds the two together.
    """
    usage = np.bincount(labels, impact.coverage)
    seen = usage > 0.01 * np.median(usage[usage > 0]) if (usage > 0).any() else usage > 0
    if not seen.any():
        return np.ones(len(usage))
    u = uncertainty(np.bincount(labels, impact.squared).astype(np.float64))
    return np.where(seen, np.clip((u / np.median(u[seen])) ** 0.125, 0.8, 1.25), 1.0)


def _on_rgb_axes(stages: Sequence[Stage]) -> tuple[Stage, ...]:
    """Codebooks whose colours, as shown, lie on the axes: their singular vectors are the axes.

    Only carriers are made from codebooks (output "fidelity" keeps each Gaussian's own colour).
    """
    book = stages[0].codebook.copy()
    axis = np.arange(len(book)) % 3
    shown = np.zeros((len(book), 3), dtype=np.float32)
    shown[np.arange(len(book)), axis] = 1.0
    book[:, :3] = (shown - 0.5) / SH_C0
    return (Stage(book, stages[0].labels), *stages[1:])
