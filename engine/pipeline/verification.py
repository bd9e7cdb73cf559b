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
from engine.pipeline.progress import Clock, Progress
from engine.pipeline.sealing import OpenedRecord
from engine.pipeline.strength import add_dc
from engine.raster import View, prepare_view, render, sh_colors
from engine.watermark.camera_finding import find_camera
from engine.watermark.claim import Claim, ClaimConfig, Verdict, decide
from engine.watermark.image_alignment import align_image
from engine.watermark.image_evidence import add_evidence, gather_image_evidence
from engine.watermark.messages import message_hex
from engine.watermark.model_evidence import Evidence, gather_model_evidence
from engine.watermark.paper_decoder import decode_paper
from engine.watermark.registration import Registration, register
from engine.watermark.spreading import signed_amplitudes
from engine.watermark.statistics import log10_binomial_tail

ROUTES = ("auto", "model", "render", "image")
ABSENCE_POWER = 0.999
"""Probability that the registration finds a piece of the asset that is there (measured: docs/RESULTS.md)."""


@dataclass(frozen=True)
class VerifyConfig:
    """What a verification can be told.

    Parameters
    ----------
    false_claim_rate : float
        Largest acceptable probability of a false claim, against chance.
    route : str
        "auto", "model", "render" or "image".
    decoder : str
        "ours", or "paper" (Eq 10 as printed) for the extracted bits; the claim is always ours.
    seed : int
        Of the registration's and the camera search's trials.
    """

    false_claim_rate: float = 1e-9
    route: str = "auto"
    decoder: str = "ours"
    seed: int = 0

    def __post_init__(self) -> None:
        if self.route not in ROUTES:
            raise InputError(f"route must be one of {', '.join(ROUTES)}, got {self.route!r}")
        if self.decoder not in ("ours", "paper"):
            raise InputError(f"decoder must be 'ours' or 'paper', got {self.decoder!r}")
        if not 0.0 < self.false_claim_rate < 1.0:
            raise InputError(f"false-claim rate must lie in (0, 1), got {self.false_claim_rate}")


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
    for number, route in enumerate(
        ("model", "render") if config.route == "auto" else (config.route,), start=1
    ):
        with clock.stage(route):
            if route == "model":
                evidence = _read_model(suspect, opened, registration)
            else:
                evidence = _read_renders(suspect, opened, registration, clock)
            # A try is a Z that was computed; the registration's hypotheses were weighed without the chips.
            claim = judge(evidence, opened, route, number, config, registration)
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
    for number, camera in enumerate(opened.cameras):
        picture = np.clip(render(moved, camera), 0.0, 1.0)
        view, reference, mark, signs = _reference_view(opened, camera)
        everywhere = np.ones(picture.shape[:2], dtype=bool)
        parts.append(gather_image_evidence(opened.layout, view, reference, picture, everywhere, mark, signs))
        clock.advance((number + 1) / len(opened.cameras))
    return add_evidence(parts)


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


def judge(
    evidence: Evidence,
    opened: OpenedRecord,
    route: str,
    tries: int,
    config: VerifyConfig,
    registration: Registration | None = None,
    notes: tuple[str, ...] = (),
) -> Claim:
    """The claim that this evidence supports."""
    spreading = opened.spreading
    transform, fraction, absence = None, None, None
    if registration is not None:
        fraction = registration.derived_fraction
        if registration.found:
            transform = {
                "scale": registration.scale, "rotation": registration.R.tolist(), "translation": registration.t.tolist()
            }  # fmt: skip
        elif route == "model":
            absence = ABSENCE_POWER
            notes = (*notes, "no piece of the asset was found in the suspect model")
    claim = decide(
        evidence.y, evidence.weights, evidence.signal, spreading.bit_of, spreading.chips, opened.message,
        tries=tries, config=ClaimConfig(false_claim_rate=config.false_claim_rate), route=route, copy=opened.copy,
        derived_fraction=fraction, absence_power=absence, transform=transform, notes=notes,
    )  # fmt: skip
    if config.decoder == "paper":
        steps = opened.layout.amplitudes * (
            opened.strength if route == "model" else _image_gain(evidence, opened)
        )
        bits, lead = decode_paper(evidence.y, steps, spreading.chips, spreading.bit_of, len(opened.message))
        matching = int((bits == opened.message).sum())
        claim = replace(
            claim, message=message_hex(bits), matching_bits=matching, bit_accuracy=matching / len(bits),
            bit_reliability=tuple(0.5 + 0.5 * lead),
            log10_binomial_tail=log10_binomial_tail(matching, len(bits)),
            notes=(*claim.notes, "bits read by the paper's rule (Eq 10); the claim is ours"),
        )  # fmt: skip
    return claim


def _image_gain(evidence: Evidence, opened: OpenedRecord) -> float:
    """Pictures give y in units of precision: the paper's step is scaled to the response that was expected."""
    amplitudes = opened.layout.amplitudes
    return float(amplitudes @ evidence.signal / max(float(amplitudes @ amplitudes), 1e-300))


def _find(image: Float32, opened: OpenedRecord, config: VerifyConfig) -> Camera | None:
    if opened.landmarks is None:
        raise InputError("this record has no landmarks: give --cameras, or embed with a landmark bank")
    found = find_camera(opened.landmarks, opened.reference, image)
    return found.camera if found is not None else None


def _nothing(opened: OpenedRecord) -> Evidence:
    zero = np.zeros(opened.layout.chips)
    return Evidence(zero, zero, zero)
