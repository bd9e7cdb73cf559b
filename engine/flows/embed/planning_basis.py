"""What a mark is planned on: the model as its key views see it, and its cells.

Made once for an embedding; `auto_profile` rehearses on it and hands it on, so that a choice costs no second look.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from engine.compress.cells import cell_features
from engine.compress.hvq import Stage, group_means, quantize
from engine.compress.impact import Impact, frequency_impact, measure_impact, sh_curvature, uncertain, uncertainty
from engine.errors import InputError
from engine.flows.embed.config import CONFIG
from engine.flows.embed.profiles import EmbedConfig
from engine.flows.embed.variant import PLAIN, Variant
from engine.flows.progress import Clock
from engine.flows.views.camera_rig import Extent, make_rig, measure_extent
from engine.flows.views.render_cost import check_drawable
from engine.flows.views.view_set import ViewSet, look
from engine.formats.file_writing import stray_rows
from engine.model import Bool, Camera, Float32, Float64, GaussianModel
from engine.watermark.config import CONFIG as WATERMARK
from engine.watermark.keys import POSE, OwnerKey, uniform


@dataclass(frozen=True, eq=False)
class Groundwork:
    """A model seen from its key views."""

    extent: Extent  # of the model as it came
    views: ViewSet  # with the model and the cameras
    impact: Impact
    config: EmbedConfig  # under which it was made
    variant: Variant
    own: Sequence[Camera] = ()  # the owner's cameras, where there are any

    @property
    def model(self) -> GaussianModel:
        """Whose groundwork it is."""
        return self.views.model

    @property
    def cameras(self) -> Sequence[Camera]:
        """The key views."""
        return self.views.cameras

    @cached_property
    def stages(self) -> tuple[Stage, ...]:
        """The quantiser: the file's own codes where the variant says so, else ours."""
        own = self.variant.own_stages(self.model, self.colors)
        config = self.config.quantize
        if self.config.output == "compact":
            fewer = CONFIG.plan.compact
            config = replace(config, cells=config.cells // fewer, min_members=config.min_members * fewer)
        elif self.config.recovers:  # few are left, and the key joins as many cells of them
            config = replace(config, min_members=1)
        return own or quantize(self.model, self.colors, self.extent.radius, config, self._coarse)

    @property
    def _coarse(self) -> Bool | None:
        """(N, K) coefficients above the paper's tau_unc, which its later stages leave alone; None where all count."""
        if self.config.paper.tau_unc <= 0:
            return None
        return uncertain(sh_curvature(self.model, self.views.views, self.cameras), self.config.paper.tau_unc)

    @cached_property
    def colors(self) -> Float64:
        """(N,) how much an error in each Gaussian's colour is seen."""
        return color_weights(self.model, self.impact, by_frequency=self.config.paper.frequency)

    @cached_property
    def cell_features(self) -> Float64:
        """(M, 6) mean position and colour, as the quantiser weighs them, of each public cell."""
        stage = self.stages[0]
        return group_means(cell_features(self.model, self.extent.radius), stage.labels, self.colors).astype(np.float64)

    @property
    def picture_scale(self) -> Float64:
        """(V, 1) by how much more a picture of `reference_pixels` shows than each key view does."""
        pixels = WATERMARK.planning.reference_pixels
        return np.array([[pixels / (camera.width * camera.height)] for camera in self.cameras])

    def unseen(self, count: int, side: int, rng: np.random.Generator) -> list[Camera]:
        """Up to so many views, of `side` pixels, that are no key views: of the owner's cameras where some are left."""
        taken = {camera.viewmat.tobytes() for camera in self.cameras}
        left = [camera for camera in self.own if camera.viewmat.tobytes() not in taken]
        if left:
            spread = np.linspace(0, len(left) - 1, min(count, len(left))).round().astype(int)
            return [left[i].with_side(side) for i in spread]
        return make_rig(self.model, count, side, side, jitter=rng.random((count, 4)), extent=self.extent)

    def of(self, model: GaussianModel, clock: Clock) -> "Groundwork":
        """Of another model in its place, seen from its views."""
        if model is self.model:
            return self
        return _seen(model, self.cameras, self.extent, self.config, self.variant, clock, self.own)

    def views_of(self, model: GaussianModel, clock: Clock) -> ViewSet:
        """Another model from these views, without its impact."""
        if model is self.model:
            return self.views
        return look(model, self.cameras, clock.advance, self.variant.at_view)


def color_weights(model: GaussianModel, impact: Impact, *, by_frequency: bool = False) -> Float64:
    """(N,) how much an error in each Gaussian's colour is seen: the inverse of its Laplace uncertainty.

    That is the curvature of the render error itself. The paper's profiles weigh `by_frequency`, with W^freq, instead.
    """
    if by_frequency:
        return frequency_impact(model, impact)
    return np.asarray(1.0 / uncertainty(impact.squared))


def lay_groundwork(
    model: GaussianModel,
    key: OwnerKey,
    original_sha256: str,
    config: EmbedConfig,
    cameras: Sequence[Camera] | None = None,
    variant: Variant = PLAIN,
    clock: Clock | None = None,
) -> Groundwork:
    """Look at a model from the views that the owner's key draws.

    InputError if no copy of the model could be registered: too few Gaussians, or centres in a point or on a line; if
    it would take hours to draw (`render_cost`); or if no view shows anything of it.

    Parameters
    ----------
    original_sha256 : str
        Hex digest of the owner's file.
    config : EmbedConfig
        Number and size of the key views; the quantiser.
    cameras : sequence of Camera, optional
        The owner's own; key views are chosen among them. Generated from the model otherwise.
    """
    extent = measure_extent(model)
    _check_placeable(model, extent)
    key_cameras = _key_cameras(model, key, bytes.fromhex(original_sha256), config, cameras, extent)
    check_drawable(model, key_cameras)
    return _seen(model, key_cameras, extent, config, variant, clock or Clock(), cameras or ())


def _seen(
    model: GaussianModel,
    cameras: Sequence[Camera],
    extent: Extent,
    config: EmbedConfig,
    variant: Variant,
    clock: Clock,
    own: Sequence[Camera],
) -> Groundwork:
    views = look(model, cameras, clock.advance, variant.at_view)
    if all(_is_blank(image) for image in views.images):
        raise InputError(
            "no key view shows anything of this model, only one color: see with `mark3dgs inspect` whether positions, "
            "sizes and opacities were read as they were meant; or give cameras that look at it (--cameras)"
        )
    return Groundwork(extent, views, measure_impact(model, views.views, views.images), config, variant, own)


def _is_blank(image: Float32) -> bool:
    """Whether all pixels (H, W, 3) show one color, colors outside 0..1 as a screen shows them."""
    shown = np.clip(image, 0.0, 1.0).reshape(-1, 3)
    return bool((shown == shown[0]).all())


def _check_placeable(model: GaussianModel, extent: Extent) -> None:
    """Refuse what no registration could place again: centres in one point, on a line, or rounded away."""
    if len(model) < 64:
        raise InputError(f"a mark needs at least 64 Gaussians, this model has {len(model)}")
    means = model.means.astype(np.float64)
    furthest = float(np.abs(means).max())
    if extent.radius <= float(np.spacing(np.float32(np.abs(extent.center).max()))):
        raise InputError(
            f"this model lies {furthest:.3g} from the origin and is {extent.radius:.3g} across: float32 cannot tell "
            "its centres apart; move it nearer"
        )
    kept = means[~stray_rows(model.means)]  # a single one far away would stretch any model to a line
    spread = np.linalg.svd(np.cov(kept.T, bias=True), compute_uv=False)  # variances along the principal axes
    if spread[1] <= CONFIG.plan.least_width**2 * spread[0]:
        raise InputError(
            "the centres of this model lie in one point or on a line: a copy of it could not be registered"
        )


def _key_cameras(
    model: GaussianModel,
    key: OwnerKey,
    asset: bytes,
    config: EmbedConfig,
    cameras: Sequence[Camera] | None,
    extent: Extent,
) -> list[Camera]:
    """The pose key: views chosen by the owner's key, among the owner's cameras or around the model."""
    draw = uniform(key.derive(POSE, asset), 4 * config.views).reshape(config.views, 4)
    if not cameras:
        return make_rig(model, config.views, config.view_size, config.view_size, jitter=draw, extent=extent)
    count = min(config.views, len(cameras))
    slots = np.linspace(0, len(cameras), count + 1)
    slot = [int(low + u * (high - low)) for low, high, u in zip(slots[:-1], slots[1:], draw[:, 0], strict=False)]
    chosen = [cameras[min(i, len(cameras) - 1)] for i in slot]
    return [camera.with_side(min(config.view_size, max(camera.width, camera.height))) for camera in chosen]
