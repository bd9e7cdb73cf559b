"""The verification flow: suspect -> registration -> displacements -> claim. One decoder for all evidence.

Routes: `model` (the suspect's Gaussians against the reference's), `render` (the suspect model seen at the pose key
as a black box), `image` (pictures whose camera is known, or found).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from engine.errors import InputError
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.numerics.similarity import transform_model
from engine.pipeline.judging import VerifyConfig, judge
from engine.pipeline.progress import Clock, Progress
from engine.pipeline.sealing import OpenedRecord
from engine.pipeline.strength import add_dc
from engine.raster import View, prepare_view, render, sh_colors
from engine.watermark.camera_finding import find_camera
from engine.watermark.claim import Claim, Verdict
from engine.watermark.image_alignment import align_image
from engine.watermark.image_evidence import add_evidence, gather_image_evidence
from engine.watermark.model_evidence import Evidence, gather_model_evidence
from engine.watermark.registration import Registration, register
from engine.watermark.spreading import signed_amplitudes

__all__ = ["Verification", "VerifyConfig", "judge", "verify_images", "verify_model"]

RENDER_SIZE = 512
"""Longest side of a suspect's render at the pose key, pixels."""


@dataclass(frozen=True, eq=False)
class Verification:
    """A claim, the evidence it rests on, and what it cost."""

    claim: Claim
    evidence: Evidence
    seconds: float
    seconds_by_stage: dict[str, float]

    def report(self) -> dict[str, Any]:
        """Plain values for `verify --json`."""
        return {
            **self.claim.to_json(),
            "seconds": self.seconds,
            "seconds_by_stage": self.seconds_by_stage,
        }


def verify_model(
    suspect: GaussianModel,
    opened: OpenedRecord,
    config: VerifyConfig | None = None,
    progress: Progress | None = None,
) -> Verification:
    """Does this model carry the record's mark?

    Parameters
    ----------
    suspect : GaussianModel
    opened : OpenedRecord
    config : VerifyConfig, optional
        Route "auto" reads the Gaussians, and looks at renders of the pose key only when that is not conclusive.
    progress : callable, optional

    Returns
    -------
    Verification
    """
    config = config or VerifyConfig()
    if config.route == "image":
        raise InputError("route 'image' takes pictures; a model goes by 'model', 'render' or 'auto'")
    if len(suspect) == 0:
        raise InputError("the suspect model is empty")
    clock = Clock(progress)
    with clock.stage("register"):
        registration = register(opened.reference, suspect, seed=config.seed)
    best: Verification | None = None
    routes = ("model", "render") if config.route == "auto" else (config.route,)
    for route in routes:
        with clock.stage(route):
            if route == "model":
                evidence = _read_model(suspect, opened, registration)
            else:
                evidence = _read_renders(suspect, opened, registration, clock)
            # A try is a Z that may be computed: all of them count from the first on, or the rates of the routes would
            # add up beyond the one asked for. The registration's hypotheses were weighed without the chips.
            claim = judge(evidence, opened, route, len(routes), config, registration)
        if best is None or claim.verdict is Verdict.MARKED:
            best = Verification(claim, evidence, 0.0, {})
        if claim.verdict is not Verdict.INCONCLUSIVE:
            break
    assert best is not None
    return replace(best, seconds=clock.total, seconds_by_stage=clock.seconds)


def verify_images(
    images: Sequence[Float32],
    opened: OpenedRecord,
    config: VerifyConfig | None = None,
    cameras: Sequence[Camera] | None = None,
    progress: Progress | None = None,
) -> Verification:
    """Do these pictures show a model that carries the record's mark?

    Parameters
    ----------
    images : sequence of (h, w, 3) float32
        Range 0 to 1; any size, possibly rotated, scaled or cropped.
    opened : OpenedRecord
    config : VerifyConfig, optional
    cameras : sequence of Camera, optional
        One for each picture, where known; found from the record's landmarks otherwise.
    progress : callable, optional

    Returns
    -------
    Verification
        Of all pictures together.
    """
    config = config or VerifyConfig()
    if config.route not in ("auto", "image"):
        raise InputError(f"route {config.route!r} takes a model; pictures go by 'image' or 'auto'")
    if not images:
        raise InputError("no picture was given")
    if cameras is not None and len(cameras) != len(images):
        raise InputError(f"{len(images)} pictures but {len(cameras)} cameras")
    clock = Clock(progress)
    parts, notes = [], []
    for number, image in enumerate(images):
        camera = cameras[number] if cameras is not None else None
        if camera is None:
            with clock.stage("find camera"):
                camera = _find(image, opened, config)
            if camera is None:
                notes.append(f"picture {number + 1}: no view of this asset was recognised")
                continue
        with clock.stage("read picture"):
            evidence = _read_picture(image, camera, opened)
        if evidence is None:
            notes.append(f"picture {number + 1}: it could not be aligned to the view of its camera")
        else:
            parts.append(evidence)
    with clock.stage("decide"):
        evidence = add_evidence(parts) if parts else _nothing(opened)
        claim = judge(evidence, opened, "image", 1, config, None, tuple(notes))
    return Verification(claim, evidence, clock.total, clock.seconds)


def _read_model(suspect: GaussianModel, opened: OpenedRecord, registration: Registration) -> Evidence:
    evidence = gather_model_evidence(
        opened.layout,
        opened.reference.sh[:, 0],
        suspect.sh[:, 0],
        registration.matches,
        registration.match_quality,
    )
    return Evidence(evidence.y, evidence.weights, opened.strength * evidence.signal)


def _read_renders(
    suspect: GaussianModel, opened: OpenedRecord, registration: Registration, clock: Clock
) -> Evidence:
    """The suspect as a black box: rendered at the pose key and read as pictures, which need no alignment."""
    moved = suspect
    if registration.found:
        moved = transform_model(suspect, registration.scale, registration.R, registration.t)
    parts = []
    for number, camera in enumerate(_no_larger(camera) for camera in opened.cameras):
        picture = np.clip(render(moved, camera), 0.0, 1.0)
        view, reference, mark, signs = _reference_view(opened, camera)
        everywhere = np.ones(picture.shape[:2], dtype=bool)
        parts.append(gather_image_evidence(opened.layout, view, reference, picture, everywhere, mark, signs))
        clock.advance((number + 1) / len(opened.cameras))
    return add_evidence(parts)


def _no_larger(camera: Camera) -> Camera:
    """The camera at no more than RENDER_SIZE pixels a side: all key views together see enough, and soon."""
    shrink = min(1.0, RENDER_SIZE / max(camera.width, camera.height))
    return camera.resized(max(1, round(camera.width * shrink)), max(1, round(camera.height * shrink)))


def _read_picture(image: Float32, camera: Camera, opened: OpenedRecord) -> Evidence | None:
    """Evidence of one picture from a known camera, or None where it does not fit that camera's view."""
    view, reference, mark, signs = _reference_view(opened, camera)
    alignment = align_image(reference, image)
    if alignment is None:
        return None
    return gather_image_evidence(
        opened.layout, view, reference, alignment.warped, alignment.mask, mark, signs
    )


def _reference_view(opened: OpenedRecord, camera: Camera) -> tuple[View, Float32, Float32, Float64]:
    """Prepared view, clipped render of the reference, what the mark adds to it, and the signs of its chips."""
    signed = signed_amplitudes(opened.layout.amplitudes * opened.strength, opened.spreading, opened.message)
    marked_sh = add_dc(opened.reference.sh, opened.layout.displace(signed))
    view = prepare_view(opened.reference, camera)
    position = camera.position.astype(np.float32)
    plain, marked = (
        np.clip(view.render(sh_colors(sh, opened.reference.means, position))[0], 0.0, 1.0)
        for sh in (opened.reference.sh, marked_sh)
    )
    return view, plain, marked - plain, np.sign(signed)


def _find(image: Float32, opened: OpenedRecord, config: VerifyConfig) -> Camera | None:
    if opened.landmarks is None:
        raise InputError("this record has no landmarks: give --cameras, or embed with a landmark bank")
    found = find_camera(opened.landmarks, opened.reference, image)
    return found.camera if found is not None else None


def _nothing(opened: OpenedRecord) -> Evidence:
    zero = np.zeros(opened.layout.chips)
    return Evidence(zero, zero, zero)
