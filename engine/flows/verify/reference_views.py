"""A record's reference as a camera sees it, and what a mark of public signs adds to that."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from engine.flows.records.opened_record import OpenedRecord
from engine.flows.views.camera_rig import measure_extent
from engine.model import SH_C0, Bool, Camera, Float32, GaussianModel
from engine.numerics.resampling import smooth
from engine.numerics.spherical_harmonics import sh_basis
from engine.pictures.alignment.blur import Blur, find_blur
from engine.pictures.alignment.color_change import Alike, ColorChange, Misfit, Neighborhoods, find_color_change
from engine.pictures.alignment.config import CONFIG
from engine.pictures.alignment.tone_and_light import ViewerTone, find_viewer_tone
from engine.pictures.landmarks.keypoints import luma
from engine.raster import RasterSettings, Rendering, View, draw, prepare_view, sh_colors
from engine.watermark.grain import ATTRIBUTES, Grain, roughen
from engine.watermark.grain_pictures import GrainView
from engine.watermark.image_evidence import PictureEvidence, PublicMark, gather_image_evidence
from engine.watermark.spreading import public_signs
from engine.watermark.unpredictability import public_misfit

OPAQUE = CONFIG.color_change.opaque
PLAIN = RasterSettings(antialiased=False, kernel="gaussian")
"""How the grain's gradient is drawn where discs or antialiased Gaussians have none: near enough."""


class ReferenceViews:
    """A record's reference, and one with a mark of public signs, to be seen from many cameras; both with their colors
    changed, where the suspect's were."""

    def __init__(self, opened: OpenedRecord, change: ColorChange | None = None) -> None:
        model, layout, grain = opened.reference, opened.layout, opened.grain
        self.opened = opened
        self.change = change
        self.signs = public_signs(layout.chips + grain.chips(len(model)))
        self._tint = layout.displace(layout.amplitudes * self.signs[: layout.chips])
        if change is not None:
            model = model.with_dc(change.shown(model.sh[:, 0]))
            self._tint = change.apply(self._tint)
        self._model = model
        rough = self.signs[layout.chips :].astype(np.float32).reshape(-1, ATTRIBUTES)
        self._rough = roughen(model, grain, rough) if grain.there else model

    def at(
        self, camera: Camera, settings: RasterSettings = RasterSettings(), tone: ViewerTone | None = None
    ) -> "ReferenceView":
        """The reference from one camera; `tone` is the viewer's."""
        model, grain = self._model, self.opened.grain
        own = steep = toned = None
        if tone is not None:
            own = sh_colors(model.sh, model.means, camera.position)
            toned, steep = tone(own), tone.slope(own)
        drawn = draw(model, camera, settings=settings, colors=toned)
        view = prepare_view(self._rough, camera, settings) if grain.there else drawn.view
        # As displaced harmonics show, but for what is held at black; to copy all took a tenth of a picture's time.
        colors = np.maximum((drawn.colors if own is None else own) + seen_shift(self._tint, model, camera), 0.0)
        colors = colors if tone is None else tone(colors)
        plain, marked = (np.clip(image, 0.0, 1.0) for image in (drawn.image, view.render(colors)[0]))
        geometry = grain_view(drawn, camera, grain, toned)
        return ReferenceView(self, drawn.view, plain, drawn.alpha, marked - plain, geometry, tone=tone, steep=steep)

    def tone(self, camera: Camera, settings: RasterSettings, picture: Float32) -> ViewerTone | None:
        """The tone curve that the viewer of a picture (H, W, 3) from this camera applied to every Gaussian, if any."""
        return find_viewer_tone(self._model, camera, settings, picture)

    @cached_property
    def _neighborhoods(self) -> Neighborhoods:
        return Neighborhoods(self.opened.reference.means)

    @cached_property
    def _alike(self) -> Alike:
        return Alike(self.opened.reference.means, self.opened.reference.sh[:, 0])

    @cached_property
    def _misfit(self) -> Misfit:
        reference, layout = self.opened.reference, self.opened.layout
        size = np.sqrt(np.square(layout.displace(self.opened.strength * layout.amplitudes)).mean())
        return Misfit(public_misfit(reference, measure_extent(reference).radius), float(size))

    def changed_as(self, view: "ReferenceView", picture: Float32, mask: Bool) -> "ReferenceViews | None":
        """The reference with its colors changed as those of the model that a picture (H, W, 3) in a view's pixels
        shows; None where they were not, or are changed already."""
        changed = self.change is not None or view.blur is not None or view.tone is not None
        if changed or self.opened.layout.width != 3:
            return None
        usable = mask & (view.alpha > OPAQUE)
        colors = self.opened.reference.sh[:, 0]
        seen = (colors, view.view, view.plain, picture, usable)
        change = find_color_change(self._neighborhoods, self._alike, lambda: self._misfit, *seen)
        return None if change is None else ReferenceViews(self.opened, change)


@dataclass(frozen=True, eq=False)
class ReferenceView:
    """What one camera sees of a reference."""

    of: ReferenceViews
    view: View
    plain: Float32  # (H, W, 3) clipped render of the reference
    alpha: Float32  # (H, W) its opacity
    mark: Float32  # (H, W, 3) what a mark of public signs adds
    geometry: GrainView | None
    blur: Blur | None = None  # that `plain`, `alpha` and `mark` went through
    tone: ViewerTone | None = None  # that the Gaussians' colors went through,
    steep: Float32 | None = None  # and its slope (N, 3) at them

    def blurred_as(self, picture: Float32, mask: Bool | None = None) -> "ReferenceView":
        """This sharp view, blurred as a picture (H, W, 3) in its pixels is, itself where that is sharp; `mask` (H, W)
        as of `find_blur`."""
        blur = find_blur(luma(self.plain), self.alpha, luma(picture), mask)
        if blur is None:
            return self
        plain, alpha, mark = (blur.apply(image) for image in (self.plain, self.alpha, self.mark))
        return replace(self, plain=plain, alpha=alpha, mark=mark, blur=blur)

    def softened(self, sigma: float) -> "ReferenceView":
        """This view as a picture shows it that was blurred by `sigma` pixels."""
        return replace(self, plain=smooth(self.plain, sigma), mark=smooth(self.mark, sigma))

    def read(self, picture: Float32, mask: Bool, through: Float32 | None = None) -> PictureEvidence:
        """Evidence of a picture that lies in this view's pixels."""
        seen = (self.of.opened.layout, self.view, self.plain, picture, mask)
        mark = PublicMark(self.mark, self.of.signs, self.blur, self.steep, self.of.change)
        return gather_image_evidence(*seen, mark, through, self.geometry)


def grain_view(drawn: Rendering, camera: Camera, grain: Grain, colors: Float32 | None = None) -> GrainView | None:
    """The unmarked reference as the grain is read in it, where there is one: `drawn` from this camera in `colors`."""
    if not grain.there:
        return None
    seen = drawn.view.geometry
    if seen.settings.antialiased or len(seen.discs) > 0:
        flat = replace(PLAIN, by_distance=seen.settings.by_distance)
        drawn = draw(drawn.model, camera, settings=flat, colors=colors)
    return GrainView(drawn, grain)


def seen_shift(tint: Float32, model: GaussianModel, camera: Camera) -> Float32:
    """(N, 3) what displacements of the DC coefficients (N, 3), or of all (N, 3K), add to colours that are seen from a
    camera."""
    if tint.shape[1] == 3:  # from anywhere
        return np.float32(SH_C0) * tint
    directions = model.means - camera.position.astype(np.float32)
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), np.finfo(np.float32).tiny)
    coefficients = tint.reshape(len(tint), -1, 3)
    basis = sh_basis(directions, math.isqrt(coefficients.shape[1]) - 1)
    return np.asarray(np.einsum("nk,nkc->nc", basis, coefficients), dtype=np.float32)
