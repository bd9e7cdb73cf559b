"""The verification flow: suspect -> registration -> displacements -> claim. One decoder for all evidence.

Routes: `model` (the suspect's Gaussians against the reference's), `render` (the suspect model seen at the pose key
as a black box), `image` (pictures whose camera is known, or found).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from engine.errors import InputError
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.blas import one_blas_thread
from engine.pipeline.judging import VerifyConfig, judge
from engine.pipeline.progress import Clock, Progress
from engine.pipeline.reading import read_gaussians, read_pictures, read_renders
from engine.pipeline.sealing import OpenedRecord
from engine.registration.registering import register
from engine.watermark.claim import Claim, Verdict
from engine.watermark.model_evidence import Evidence

__all__ = ["Verification", "VerifyConfig", "judge", "verify_images", "verify_model"]


@dataclass(frozen=True, eq=False)
class Verification:
    """A claim, the evidence it rests on, and what it cost."""

    claim: Claim
    evidence: Evidence
    seconds: float
    seconds_by_stage: dict[str, float]

    def report(self) -> dict[str, Any]:
        """Plain values for `verify --json`."""
        return {**self.claim.to_json(), "seconds": self.seconds, "seconds_by_stage": self.seconds_by_stage}


@one_blas_thread
def verify_model(
    suspect: GaussianModel, opened: OpenedRecord, config: VerifyConfig | None = None, progress: Progress | None = None
) -> Verification:
    """Does this model carry the record's mark?

    Parameters
    ----------
    config : VerifyConfig, optional
        Route "auto" reads the Gaussians, and looks at renders of the pose key only when that is not conclusive.
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
        notes: tuple[str, ...] = ()
        shown = registration.found
        with clock.stage(route):
            if route == "model":
                evidence = read_gaussians(suspect, opened, registration)
            else:
                seen = read_renders(suspect, opened, registration, clock)
                evidence, notes, shown = seen.evidence, seen.notes, seen.shown
            # A try is a Z that may be computed: all of them count from the first on, or the rates of the routes would
            # add up beyond the one asked for. The registration's hypotheses were weighed without the chips.
            claim = judge(evidence, opened, route, len(routes), config, registration, notes)
        # A model without a Gaussian of the reference may still show the asset: then what it shows decides.
        if best is None or claim.verdict is Verdict.MARKED or (shown and not registration.found):
            best = Verification(claim, evidence, 0.0, {})
        if claim.verdict is not Verdict.INCONCLUSIVE and registration.found:
            break
    assert best is not None
    return replace(best, seconds=clock.total, seconds_by_stage=clock.seconds)


@one_blas_thread
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
    cameras : sequence of Camera, optional
        One for each picture, where known; found from the record's landmarks otherwise.

    Returns
    -------
    Verification
        Of all pictures together.
    """
    config = config or VerifyConfig()
    if config.route not in ("auto", "image"):
        raise InputError(f"route {config.route!r} takes a model; pictures go by 'image' or 'auto'")
    clock = Clock(progress)
    evidence, notes = read_pictures(images, opened, cameras, clock)
    with clock.stage("decide"):
        claim = judge(evidence, opened, "image", 1, config, None, notes)
    return Verification(claim, evidence, clock.total, clock.seconds)
