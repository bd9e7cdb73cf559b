"""A record's reference as cameras see it, and what a mark adds there: what pictures are held against and read with.

That mark has the record's cells and amplitudes and public signs: what pictures say is read without any secret.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from engine.flows.records.opened_record import OpenedRecord
from engine.model import SH_C0, Bool, Camera, Float32, GaussianModel
from engine.numerics.resampling import smooth
from engine.numerics.spherical_harmonics import sh_basis
from engine.raster import RasterSettings, View, draw, prepare_view
from engine.watermark.grain import ATTRIBUTES, roughen
from engine.watermark.grain_pictures import GrainView
from engine.watermark.image_evidence import PictureEvidence, PublicMark, gather_image_evidence
from engine.watermark.spreading import public_signs

PLAIN = RasterSettings(antialiased=False, kernel="gaussian")
"""How the grain's gradient is drawn where discs or antialiased Gaussians have none: near enough."""


class ReferenceViews:
    """A record's reference, and one with a mark of public signs, to be seen from many cameras."""

    def __init__(self, opened: OpenedRecord) -> None:
        model, layout, grain = opened.reference, opened.layout, opened.grain
        self.opened = opened
        self.signs = public_signs(layout.chips + grain.chips(len(model)))
        self._tint = layout.displace(layout.amplitudes * self.signs[: layout.chips])
        rough = self.signs[layout.chips :].astype(np.float32).reshape(-1, ATTRIBUTES)
        self._rough = roughen(model, grain, rough) if grain.there else model

    def at(self, camera: Camera, settings: RasterSettings = RasterSettings()) -> ReferenceView:
        """The reference from one camera."""
        model, grain = self.opened.reference, self.opened.grain
        drawn = draw(model, camera, settings=settings)
        view = prepare_view(self._rough, camera, settings) if grain.there else drawn.view
        # As displaced harmonics show, but for what is held at black; to copy all took a tenth of a picture's time.
        colors = np.maximum(drawn.colors + seen_shift(self._tint, model, camera), 0.0)
        plain, marked = (np.clip(image, 0.0, 1.0) for image in (drawn.image, view.render(colors)[0]))
        geometry = None
        if grain.there:
            seen = drawn.view.geometry
            smooth = seen.settings.antialiased or len(seen.discs) > 0
            geometry = GrainView(
                draw(model, camera, settings=replace(PLAIN, by_distance=settings.by_distance)) if smooth else drawn,
                grain,
            )
        return ReferenceView(self, drawn.view, plain, drawn.alpha, marked - plain, geometry)


@dataclass(frozen=True, eq=False)
class ReferenceView:
    """What one camera sees of a reference."""

    of: ReferenceViews
    view: View
    plain: Float32  # (H, W, 3) clipped render of the reference
    alpha: Float32  # (H, W) its opacity
    mark: Float32  # (H, W, 3) what a mark of public signs adds
    geometry: GrainView | None

    def softened(self, sigma: float) -> ReferenceView:
        """This view as a picture shows it that was blurred by `sigma` pixels."""
        return replace(self, plain=smooth(self.plain, sigma), mark=smooth(self.mark, sigma))

    def read(self, picture: Float32, mask: Bool, through: Float32 | None = None) -> PictureEvidence:
        """Evidence of a picture that lies in this view's pixels."""
        seen = (self.of.opened.layout, self.view, self.plain, picture, mask)
        return gather_image_evidence(*seen, PublicMark(self.mark, self.of.signs), through, self.geometry)


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
