"""What one picture says: laid over the reference's view from its camera, and read there; or, where a coder's blocks lie
in it, in its own pixels; or, where the model was bent, part by part.

A block's coefficients say more than the pixels they decode to, but only where nothing was resampled: then it is not
the picture that is carried to the camera's view, but the camera to the picture.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from engine.flows.verify.reference_views import ReferenceView, ReferenceViews
from engine.model import Camera, Float32
from engine.pictures.alignment.background import Background, find_background
from engine.pictures.alignment.local_flow import align_locally
from engine.pictures.alignment.planar import Alignment, align_either_hand, align_near, align_upright, near_motions
from engine.pictures.camera.camera_motion import carried
from engine.pictures.camera.camera_search import FoundCamera
from engine.pictures.jpeg.block_grid import JpegGrid, find_grid
from engine.pictures.jpeg.quantizer_score import agreement, match_exposure
from engine.raster import RasterSettings
from engine.watermark.image_evidence import PictureEvidence

__all__ = ["read_found", "read_known"]

CARRIED = 2
"""Times that a camera is carried to a picture: the first render there shows what alignment over the other missed."""
SOFT = (0.35, 0.45, 0.55)
"""Blurs, pixels, that turning or shrinking a picture may have left in it: bilinear turns come to 0.45."""


@dataclass(frozen=True, eq=False)
class _Laid:
    """A picture over a view of the reference."""

    view: ReferenceView
    alignment: Alignment
    behind: Background | None  # what it shows behind the model


def read_known(image: Float32, camera: Camera, reference: ReferenceViews) -> tuple[PictureEvidence | None, bool]:
    """Evidence of one picture (h, w, 3) from a known camera, None where it does not fit that camera's view; and whether
    it was turned over to fit."""
    view = reference.at(camera)
    alignment = align_either_hand(view.plain, image)
    if alignment is None:
        return None, False
    turned, face = alignment.mirrored, alignment.suspect
    laid = _carried(_Laid(view, alignment, None), face, reference, RasterSettings(), False)
    return laid.view.read(laid.alignment.warped, laid.alignment.mask), turned


def read_found(image: Float32, found: FoundCamera, reference: ReferenceViews) -> PictureEvidence | None:
    """Evidence of a picture (h, w, 3) whose camera was found, whatever it shows behind the model, and of a model that
    was bent, part by part."""
    view = reference.at(found.camera, found.drawn)
    whole, bent = _read_whole(view, image, found, reference), align_locally(view.plain, view.alpha, image)
    if bent is None:
        return whole
    # No camera says where it is clear, and so what lies behind.
    parts = view.read(bent.warped, bent.mask)
    return parts if whole is None or parts.promise > whole.promise else whole


def _read_whole(
    view: ReferenceView, image: Float32, found: FoundCamera, reference: ReferenceViews
) -> PictureEvidence | None:
    laid = _lay_over_background(view, image)
    if laid is None:
        return None
    laid = _carried(laid, image, reference, found.drawn, True)
    alignment, behind = laid.alignment, laid.behind
    if behind is None:
        return laid.view.read(alignment.warped, alignment.mask)
    mask = alignment.mask & behind.trusted
    if alignment.still:  # as its coder saw it
        return laid.view.read(image, mask, behind.through)
    return laid.view.read(alignment.warped, mask)


def _lay_over_background(view: ReferenceView, image: Float32) -> _Laid | None:
    behind = find_background(image, view.alpha)
    alignment = align_near(view.plain, image if behind is None else image - behind.through)
    return None if alignment is None else _Laid(view, alignment, behind)


def _carried(laid: _Laid, image: Float32, reference: ReferenceViews, drawn: RasterSettings, over: bool) -> _Laid:
    """The picture in its own pixels, where it shows a coder's blocks and a camera can be carried there; else as it
    was.

    Brightness tells where it lies but for what a coarse coder makes up. Of what is near, the camera answers from which
    that coder would have stored most of what it did.
    """
    height, width = image.shape[:2]
    motion = laid.alignment.matrix
    if np.linalg.det(motion[:2, :2]) < 0:  # no camera turns a picture over
        image = np.ascontiguousarray(image[:, ::-1])
        motion = np.array([[-1.0, 0.0, width], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) @ motion
    grid = None if laid.alignment.still else find_grid(image)
    if grid is None:
        return laid
    best, most = laid, 0.0
    for start in near_motions(motion, laid.view.plain.shape[:2]):
        camera, matrix = laid.view.view.camera, start
        for _ in range(CARRIED):
            there = carried(camera, matrix, width, height)
            if there is None:
                break
            view = reference.at(there, drawn)
            behind = find_background(image, view.alpha) if over else None
            through = np.float32(0.0) if behind is None else behind.through
            near = align_upright(view.plain, image - through)
            if near is None:
                break
            camera, (matrix, alignment) = there, near
            own = _Laid(view, alignment, behind)
            agreed = _agreement(own, image, grid)
            if agreed > most:
                best, most = own, agreed
    softer = [replace(best, view=best.view.softened(blur)) for blur in SOFT] if best is not laid else []
    return max([best, *softer], key=lambda own: _agreement(own, image, grid)) if softer else best


def _agreement(own: _Laid, image: Float32, grid: JpegGrid) -> float:
    through = np.float32(0.0) if own.behind is None else own.behind.through
    mask = own.alignment.mask
    exposed = np.clip(match_exposure(own.view.plain, image - through, mask) + through, 0.0, 1.0)
    return agreement(grid.part(exposed), grid.part(image), grid.part(mask), grid.quality)
