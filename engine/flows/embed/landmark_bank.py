"""From which views the bank of landmarks is made, and how many do (DESIGN 4.8)."""

from collections.abc import Callable

import numpy as np

from engine.flows.views.camera_rig import LANDMARK_SIZE, Extent, make_rig
from engine.model import Camera, GaussianModel
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.pictures.landmarks.rendered_landmarks import PER_VIEW, make_landmarks

__all__ = ["bank_views", "make_bank"]

TRIED = 3
"""Views that are looked at first: low, midway and high."""
RICH = 600
"""Landmarks each of them must show for a third of the views to do: two assets show 649 and more, of whose pictures out
of a viewer as many are found; three show 223 to 423, and the two of them that were tried lose some."""
OF_RICH = 900
"""Most landmarks of one view there."""
LEAST = 24
"""Views wanted below which none are saved."""


def make_bank(
    model: GaussianModel, extent: Extent, views: int, advance: Callable[[float], None] | None = None
) -> tuple[Landmarks, list[Camera]]:
    """Landmarks of the unmarked model from so many regular views, or fewer where these do; and the views.

    The views follow from the model and their number alone: `make_rig` gives them again. `advance` is called with the
    fraction done, 0 to 1.
    """
    rig = make_rig(model, extent.fewer(views), *LANDMARK_SIZE, extent=extent)
    if len(rig) < LEAST or extent.is_room:  # no room was measured
        return make_landmarks(model, rig, advance), rig
    first = np.arange(TRIED) * len(rig) // TRIED
    tried = make_landmarks(model, [rig[k] for k in first], most=OF_RICH)
    if np.bincount(tried.views, minlength=TRIED).min() >= RICH:
        few = make_rig(model, -(-len(rig) // 3), *LANDMARK_SIZE, extent=extent)
        return make_landmarks(model, few, advance, most=OF_RICH), few
    other = np.setdiff1d(np.arange(len(rig)), first)
    rest = make_landmarks(model, [rig[k] for k in other], advance)
    strongest = np.arange(len(tried)) - np.searchsorted(tried.views, tried.views) < PER_VIEW
    points, descriptors = (
        np.concatenate([ours[strongest], theirs])
        for ours, theirs in ((tried.points, rest.points), (tried.descriptors, rest.descriptors))
    )
    numbers = np.concatenate([first[tried.views[strongest]], other[rest.views]]).astype(np.int32)
    order = np.argsort(numbers, kind="stable")
    return Landmarks(points[order], descriptors[order], numbers[order]), rig


def bank_views(bank: Landmarks, model: GaussianModel, extent: Extent | None = None) -> list[Camera]:
    """Where a bank's landmarks were seen from: the views of an unpruned model to the last digit. Empty where it is."""
    return make_rig(model, int(bank.views.max()) + 1, *LANDMARK_SIZE, extent=extent) if len(bank) else []
