"""The copy attack (Kutter, Voloshynovskiy and Herrigel 2000): a mark lifted from one model onto another.

It does not remove a mark, it makes marks worthless: if it worked, anybody's model could be made to carry somebody
else's. Here chips hang on the digest of the reference, so the other model must neither be found derived nor read.
"""

import numpy as np

from engine.errors import InputError
from engine.flows.views.camera_rig import measure_extent
from engine.lab.sim.attack import Attacks
from engine.model import GaussianModel

__all__ = ["ATTACKS"]

ATTACKS: Attacks[GaussianModel] = Attacks("model")

NEIGHBOURS = 16
"""Gaussians whose mean colour stands for the unmarked one, where the attacker has only the marked model."""


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
    """Both models are brought to one centre and radius; each Gaussian gets the displacement of the nearest source's.

    `source` is the marked model to lift from; needed. `clean` is the same without the mark, Gaussian by Gaussian: the
    worst case, an attacker who was sold it. Without it the mark is estimated as what a mean over 16 neighbours takes
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
        count = min(NEIGHBOURS, len(source))
        near = cKDTree(source.means).query(source.means, k=count, workers=2)[1].reshape(len(source), count)
        lifted = marked - marked[near].mean(axis=1)
    here, there = measure_extent(model), measure_extent(source)
    moved = (model.means - here.center) * (there.radius / here.radius) + there.center
    nearest = cKDTree(source.means).query(moved, workers=2)[1]
    return model.with_dc(model.sh[:, 0] + strength * lifted[nearest])
