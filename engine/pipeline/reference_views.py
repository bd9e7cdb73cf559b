"""A record's reference as cameras see it, and what a mark adds there: what pictures are held against and read with.

That mark has the record's cells and amplitudes and public signs: what pictures say is read without any secret.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from engine.model import Bool, Camera, Float32
from engine.numerics.resampling import smooth
from engine.pipeline.marking import displaced
from engine.pipeline.sealing import OpenedRecord
from engine.raster import RasterSettings, View, draw, render
from engine.watermark.grain_pictures import GrainView
from engine.watermark.image_evidence import PictureEvidence, gather_image_evidence
from engine.watermark.spreading import public_signs

PLAIN = RasterSettings(antialiased=False, kernel="gaussian")
"""How the grain's gradient is drawn where discs or antialiased Gaussians have none: near enough."""


class ReferenceViews:
    """A record's reference, and one with a mark of public signs, to be seen from many cameras."""

    def __init__(self, opened: OpenedRecord) -> None:
        model, layout, grain = opened.reference, opened.layout, opened.grain
        self.opened = opened
        self.signs = public_signs(layout.chips + grain.chips(len(model)))
        rough = self.signs[layout.chips :] if grain.there else None
        self.marked = displaced(model, layout, layout.amplitudes * self.signs[: layout.chips], grain, rough)

    def at(self, camera: Camera, settings: RasterSettings = RasterSettings()) -> ReferenceView:
        """The reference from one camera."""
        model, grain = self.opened.reference, self.opened.grain
        drawn = draw(model, camera, settings=settings)
        plain, marked = (
            np.clip(image, 0.0, 1.0) for image in (drawn.image, render(self.marked, camera, settings=settings))
        )
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
        return gather_image_evidence(*seen, self.mark, self.of.signs, through, self.geometry)
