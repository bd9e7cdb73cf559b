"""From which views the bank of landmarks is made, and how many do (DESIGN 4.8)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from engine.flows.embed.config import CONFIG
from engine.flows.views.camera_rig import Extent, make_rig
from engine.flows.views.config import CONFIG as VIEWS
from engine.model import Camera, GaussianModel
from engine.pictures.landmarks.config import CONFIG as LANDMARKS
from engine.pictures.landmarks.landmark_set import Landmarks
from engine.pictures.landmarks.rendered_landmarks import make_landmarks

if TYPE_CHECKING:
    from engine.catalogue.entry import SeenPoints

_CONFIG = CONFIG.bank


@dataclass(frozen=True, eq=False)
class Bank:
    """Landmarks of the unmarked model, by which the camera of a screenshot is found, and the views they are from."""

    landmarks: Landmarks
    views: list[Camera]

    @cached_property
    def seen(self) -> SeenPoints:
        """What an index of many assets keeps of them, made where there is one."""
        from engine.catalogue.entry import see_points  # SciPy's trees are slow to load

        return see_points(self.landmarks, self.views)


def make_bank(
    model: GaussianModel, extent: Extent, views: int, advance: Callable[[float], None] | None = None
) -> tuple[Landmarks, list[Camera]]:
    """Landmarks of the unmarked model from so many regular views, or fewer where these do; and the views.

    The views follow from the model and their number alone: `make_rig` gives them again. `advance` is called with the
    fraction done, 0 to 1.
    """
    rig = make_rig(model, extent.fewer(views), *VIEWS.rig.landmark_size, extent=extent)
    if len(rig) < _CONFIG.least or extent.is_room:  # no room was measured
        return make_landmarks(model, rig, advance), rig
    first = np.arange(_CONFIG.tried) * len(rig) // _CONFIG.tried
    tried = make_landmarks(model, [rig[k] for k in first], most=_CONFIG.of_rich)
    if np.bincount(tried.views, minlength=_CONFIG.tried).min() >= _CONFIG.rich:
        few = make_rig(model, -(-len(rig) // 3), *VIEWS.rig.landmark_size, extent=extent)
        return make_landmarks(model, few, advance, most=_CONFIG.of_rich), few
    other = np.setdiff1d(np.arange(len(rig)), first)
    rest = make_landmarks(model, [rig[k] for k in other], advance)
    strongest = np.arange(len(tried)) - np.searchsorted(tried.views, tried.views) < LANDMARKS.per_view
    points, descriptors = (
        np.concatenate([ours[strongest], theirs])
        for ours, theirs in ((tried.points, rest.points), (tried.descriptors, rest.descriptors))
    )
    numbers = np.concatenate([first[tried.views[strongest]], other[rest.views]]).astype(np.int32)
    order = np.argsort(numbers, kind="stable")
    return Landmarks(points[order], descriptors[order], numbers[order]), rig


def bank_views(bank: Landmarks, model: GaussianModel, extent: Extent | None = None) -> list[Camera]:
    """Where a bank's landmarks were seen from: the views of an unpruned model to the last digit. Empty where it is."""
    return make_rig(model, int(bank.views.max()) + 1, *VIEWS.rig.landmark_size, extent=extent) if len(bank) else []
