"""Purification by contribution: GSPure's idea (AAAI 2026), a hidden thing shows as Gaussians that serve no view."""

from collections.abc import Sequence

import numpy as np

from engine.errors import InputError
from engine.flows.views.camera_rig import measure_extent
from engine.lab.sim.adversaries.density import cluster_by_density
from engine.lab.sim.attack import Attacks
from engine.lab.sim.model_population import impact
from engine.model import Camera, Float64, GaussianModel

__all__ = ["ATTACKS"]

ATTACKS: Attacks[GaussianModel] = Attacks("model")

NEIGHBOURS = 4
"""Neighbours of a core point: GSPure's second threshold."""
LEAST_CLUSTER = 32
"""Fewest Gaussians of a cluster."""


@ATTACKS.add(
    "remove clusters of Gaussians that contribute little to views",
    "least contribution, means of all",
    0.25,
    (0.01, 0.03, 0.1, 0.25, 0.5, 1.0),
    "(0, inf)",
)
def purify(
    model: GaussianModel, strength: float, rng: np.random.Generator, *, cameras: Sequence[Camera] | None = None
) -> GaussianModel:
    """Gaussians are clustered by position, contribution (`impact` over the cameras' views) and opacity with HDBSCAN.

    A cluster goes when its mean contribution lies below `strength` times the mean of all, and so does a Gaussian in no
    cluster by its own; at least one Gaussian stays. GSPure's threshold is 4 pixels on scenes of its own; ours is
    relative, so that it means the same in every scene (4 pixels are about 0.25 for 100k Gaussians in 24 views of
    256 x 256).
    """
    contribution = impact(model, cameras, rng)
    mean = float(contribution.mean())
    if mean <= 0:
        raise InputError("none of the cameras sees the model")
    relative = contribution / mean
    places = model.means.astype(np.float64) / measure_extent(model).radius
    shown = model.opacities.astype(np.float64)[:, None]
    features = np.column_stack([_even(each) for each in (places, np.log10(relative + 1e-3)[:, None], shown)])
    label = cluster_by_density(features, NEIGHBOURS, LEAST_CLUSTER)
    grouped = label >= 0
    clusters = int(label.max(initial=-1)) + 1
    members = np.bincount(label[grouped], minlength=clusters)
    sums = np.bincount(label[grouped], relative[grouped], clusters)
    worth = relative.copy()
    worth[grouped] = (sums / np.maximum(members, 1))[label[grouped]]
    keep = worth >= strength
    keep[int(np.argmax(contribution))] = True
    return model.take(keep)


def _even(values: Float64) -> Float64:
    """(N, D) over one robust spread for all columns: each attribute counts alike."""
    spread = float(np.median(np.abs(values - np.median(values, axis=0))))
    return np.asarray(values / max(spread, 1e-9))
