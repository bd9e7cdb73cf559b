"""Steps of the embedding that have no knob, taken out for an ablation through the door that variants use.

- ``uncertainty weights``: stage 0 weighs all Gaussians alike, not by the curvature of the render error.
- ``uncertainty mask``: code vectors that the views are uncertain about are displaced like the others.
- ``uncertainty``: both of these.
- ``svd``: carriers are the RGB axes, not the right singular vectors of the codebook.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from engine.compress.hvq import HvqConfig, Stage, quantize
from engine.compress.impact import Impact
from engine.errors import InputError
from engine.flows.embed.variant import PLAIN, Variant
from engine.flows.views.camera_rig import measure_extent
from engine.model import SH_C0, Float64, GaussianModel
from engine.watermark.planning import PlanConfig, visual_mask

STEPS = ("uncertainty weights", "uncertainty mask", "uncertainty", "svd")


def without(step: str, config: HvqConfig) -> Variant:
    """The variant whose embedding lacks that step of STEPS (InputError for another); the plain one for no name."""
    if not step:
        return PLAIN
    if step not in STEPS:
        raise InputError(f"no step {step!r} can be taken out; there are {', '.join(STEPS)}")
    return _Lacking(step=step, config=config)


@dataclass(frozen=True, eq=False)
class _Lacking(Variant):
    step: str = ""
    config: HvqConfig = field(default_factory=HvqConfig)
    made: list[Stage] = field(default_factory=list)

    def own_stages(self, model: GaussianModel, weights: Float64) -> tuple[Stage, ...]:
        if self.step in ("uncertainty weights", "uncertainty"):
            weights = np.ones(len(model))
        stages = quantize(model, weights, measure_extent(model).radius, self.config)
        self.made.append(stages[0])
        return _on_rgb_axes(stages) if self.step == "svd" else stages

    def emphasis_on(self, impact: Impact) -> Float64 | None:
        """The planner's mask where all cells are equally certain, over its mask as they are."""
        if self.step not in ("uncertainty mask", "uncertainty"):
            return None
        stage = self.made[-1]
        count = len(stage.codebook)
        usage = np.bincount(stage.labels, impact.coverage, count).astype(np.float64)  # (M,)
        even = replace(impact, squared=1.0 / np.bincount(stage.labels)[stage.labels])  # (N,), adds up to 1 in each cell
        wanted, usual = (visual_mask(stage, seen, usage, count, PlanConfig()) for seen in (even, impact))  # (M,)
        return np.asarray((wanted / usual)[stage.labels])  # (N,); texture cancels out


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
