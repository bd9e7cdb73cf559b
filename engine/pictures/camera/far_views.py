"""A model as it looks from afar: fewer Gaussians, and what they show from many views (DESIGN 4.8).

Nothing here sees a key or a chip.
"""

from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property

import numpy as np

from engine.kernels.jit import side_by_side
from engine.model import Camera, Float64, GaussianModel, Int64
from engine.numerics.gaussians import merge_groups
from engine.pictures.camera.camera_motion import farther, swung
from engine.pictures.camera.config import CONFIG
from engine.pictures.camera.view_points import ViewPoints, describe_view

_AXIS = 21
"""Bits that number the voxels of an axis."""


class FarViews:
    """A model seen by cameras all around it, each reduced to `side` pixels; rendered at first use. Close-ups are made
    of what others show, where `close` names them."""

    def __init__(self, model: GaussianModel, cameras: Sequence[Camera], close: Sequence[Camera] | None = None) -> None:
        self._whole, self._cameras, self._close = model, cameras, close

    @cached_property
    def model(self) -> GaussianModel:
        """What is drawn."""
        seen = self._whole.with_(sh=self._whole.sh[:, : CONFIG.far.coefficients])
        return merged_in_voxels(seen, CONFIG.far.gaussians)

    @cached_property
    def views(self) -> list[ViewPoints]:
        """From the cameras, and from `near`; views without edges are left out."""
        return [*self._away, *self._described(farther(view.camera, view.depth, CONFIG.far.near) for view in self._away)]

    @cached_property
    def parts(self) -> list[ViewPoints]:
        """From `nearer` than the cameras, each aimed at `parts` places of what its camera sees."""
        away = self._away if self._close is None else self._described(self._small(self._close))
        return self._described(_aimed(view, place) for view in away for place in _places(view))

    @cached_property
    def _away(self) -> list[ViewPoints]:
        return self._described(self._small(self._cameras))

    @staticmethod
    def _small(cameras: Sequence[Camera]) -> Iterator[Camera]:
        return (camera.with_side(CONFIG.edges.side) for camera in cameras)

    def _described(self, cameras: Iterable[Camera]) -> list[ViewPoints]:
        model = self.model
        described = side_by_side(lambda camera: describe_view(model, camera), cameras)
        return [view for view in described if view is not None]


def merged_in_voxels(model: GaussianModel, most: int) -> GaussianModel:
    """The model with all that lie in a voxel merged into one, voxels so large that about `most` are in use."""
    if len(model) <= most:
        return model
    places = model.means.astype(np.float64) - model.means.min(axis=0)
    sample = places[:: max(1, len(model) // CONFIG.far.sample)]
    coarse = max(float(places.max()), 1e-30)
    fine = coarse / 2.0 ** (_AXIS - 1)
    for _ in range(10):  # to within one or two percent of the size
        size = float(np.sqrt(fine * coarse))
        if len(np.unique(_voxels(sample, size))) > most:
            fine = size
        else:
            coarse = size
    _, group = np.unique(_voxels(places, coarse), return_inverse=True)
    return merge_groups(model, group.reshape(-1), surface=True)


def _voxels(places: Float64, size: float) -> Int64:
    x, y, z = (places / size).astype(np.int64).T
    return np.asarray((x << 2 * _AXIS) + (y << _AXIS) + z)


def _places(view: ViewPoints) -> Float64:
    """(parts, 2) of a view's inner points, pixels, that lie far from each other."""
    places = view.inner * view.spread + view.middle
    away = np.square(places - places.mean(axis=0)).sum(axis=1)
    chosen: list[int] = []
    for _ in range(CONFIG.far.parts):
        chosen.append(int(away.argmax()))
        apart = np.square(places - places[chosen[-1]]).sum(axis=1)
        away = apart if len(chosen) == 1 else np.minimum(away, apart)
    return places[chosen]


def _aimed(view: ViewPoints, place: Float64) -> Camera:
    camera = view.camera
    shape = camera.height, camera.width
    return farther(swung(camera, place, np.array(shape[::-1]) / 2.0, 0.0, 1.0, shape), view.depth, CONFIG.far.nearer)
