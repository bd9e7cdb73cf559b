"""A second mark against the first: overwriting, and the copy attack.

Overwriting marks the stolen model once more with this program under another key. The copy attack (Kutter,
Voloshynovskiy and Herrigel 2000) lifts a mark from one model onto another. It removes nothing, but if it worked, a mark
would prove nothing: here chips depend on the digest of the reference, so the other model must neither be found derived
nor read.
"""

import numpy as np

from engine.errors import InputError
from engine.flows.views.camera_rig import make_rig, measure_extent
from engine.lab.sim.attack import Attacks
from engine.model import GaussianModel

ATTACKS: Attacks[GaussianModel] = Attacks("model")

VIEWS, VIEW_SIZE = 6, 400  # key views of the second mark, and their side in pixels


@ATTACKS.add(
    "mark once more with this program and another key",
    "PSNR of the second mark, dB",
    47.0,
    (50, 47, 45, 40, 35, 30, 25),
    "(0, inf)",
)
def overwrite(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """The same cells (the program is public), other chips; the PSNR is against the given model, worst of six views.

    The embedding's own stages, without what serves only the reading: no message has to fit, no record is kept. The
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


NEIGHBORS = 16  # Gaussians whose mean color stands for the unmarked one, where the attacker has only the marked model


@ATTACKS.add(
    "lift the mark of another model onto this one", "factor on the lifted mark", 1.0, (0.5, 1, 2, 4), "(0, inf)"
)
def transplant(
    model: GaussianModel,
    strength: float,
    rng: np.random.Generator,
    *,
    source: GaussianModel | None = None,
    clean: GaussianModel | None = None,
) -> GaussianModel:
    """Both models are brought to one center and radius; each Gaussian gets the displacement of the nearest source's.

    `source` is the marked model to lift from; needed. `clean` is the same without the mark, Gaussian by Gaussian: the
    worst case, an attacker who was sold it. Without it the mark is estimated as what a mean over 16 neighbors takes
    away. InputError where there is no source, or `clean` is not of its length.
    """
    from scipy.spatial import cKDTree

    if source is None:
        raise InputError("a mark is lifted from a marked model: source=...")
    if clean is not None and len(clean) != len(source):
        raise InputError(f"the unmarked source has {len(clean)} Gaussians, the marked one {len(source)}")
    marked = source.sh[:, 0].astype(np.float64)
    if clean is not None:
        lifted = marked - clean.sh[:, 0]
    else:
        count = min(NEIGHBORS, len(source))
        near = cKDTree(source.means).query(source.means, k=count, workers=2)[1].reshape(len(source), count)
        lifted = marked - marked[near].mean(axis=1)
    here, there = measure_extent(model), measure_extent(source)
    moved = (model.means - here.center) * (there.radius / here.radius) + there.center
    nearest = cKDTree(source.means).query(moved, workers=2)[1]
    return model.with_dc(model.sh[:, 0] + strength * lifted[nearest])
