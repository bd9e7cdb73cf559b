"""Overwriting: the attacker marks the stolen model once more with this very program, under a key of his own."""

import numpy as np

from engine.flows.views.camera_rig import make_rig, measure_extent
from engine.lab.sim.attack import Attacks
from engine.model import GaussianModel

__all__ = ["ATTACKS"]

ATTACKS: Attacks[GaussianModel] = Attacks("model")

VIEWS, VIEW_SIZE = 6, 400
"""Key views of the second mark, and their side in pixels."""


@ATTACKS.add(
    "mark once more with this program and another key",
    "PSNR of the second mark, dB",
    47.0,
    (50, 47, 45, 40, 35, 30, 25),
    "(0, inf)",
)
def overwrite(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """The same cells (he has the program), other chips; the PSNR is against the model as it came, worst of six views.

    The embedding's own stages, without what serves only the reading: no message has to fit, no record is kept. His
    key, of chips and views, is `rng`.
    """
    from engine.compress.hvq import HvqConfig, quantize
    from engine.compress.impact import measure_impact
    from engine.flows.embed.layer_strengths import add_dc, solve_strength
    from engine.flows.embed.planning_basis import color_weights
    from engine.flows.views.view_set import look
    from engine.watermark.planning import make_plan

    extent = measure_extent(model)
    rig = make_rig(model, VIEWS, VIEW_SIZE, VIEW_SIZE, jitter=rng.random((VIEWS, 4)), extent=extent)
    views = look(model, rig, lambda fraction: None)
    impact = measure_impact(model, views.views, views.images)
    stages = quantize(model, color_weights(model, impact), extent.radius, HvqConfig())
    layout = make_plan(stages, impact).layout
    signs = rng.choice(np.array([-1.0, 1.0]), layout.chips)
    displacement = layout.displace(layout.amplitudes * signs)
    solved = solve_strength(views, displacement, strength, 0.0, 1.0)
    return model.with_(sh=add_dc(model.sh, np.float32(solved.factor) * displacement))
