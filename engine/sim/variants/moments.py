"""Verifying what was taken from a scene that moves: a model exported at some moment, pictures of some moment.

See `engine.sim.variants.moving` for why this stays a theorem.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from engine.errors import InputError
from engine.model import Camera, Float32, GaussianModel
from engine.pipeline.judging import VerifyConfig
from engine.pipeline.sealing import OpenedRecord
from engine.pipeline.verification import Verification, verify_images, verify_model
from engine.registration.registering import RegistrationConfig, register
from engine.sim.variants.moving import Moving, move_record, visible

__all__ = ["find_time", "verify_moment", "verify_moving_images"]


def find_time(
    suspect: GaussianModel, opened: OpenedRecord, original: Moving, *, count: int = 9, rounds: int = 3, seed: int = 0
) -> float | None:
    """The moment at which the original looks most like a model exported from it.

    Only geometry and the registration's unmarked features decide, so the search is no further try of a claim.

    Parameters
    ----------
    count : int
        Moments tried over the whole clip.
    rounds : int
        Times the search narrows down to the neighbours of the best moment.
    seed : int
        Of the registration's trials.

    Returns
    -------
    float or None
        None where no moment of the original is found in the suspect.
    """

    shown = visible(suspect)
    rigid = RegistrationConfig(colorless=False, deformed=False)  # a wrong moment is to fit badly

    def score(time: float) -> float:
        reference = move_record(opened, original, time).reference
        return float(register(reference, shown, seed=seed, config=rigid).match_quality.sum())

    low, high = original.span
    step = (high - low) / max(count - 1, 1)
    scores: dict[float, float] = {float(t): score(float(t)) for t in np.linspace(low, high, count)}
    for _ in range(rounds):
        best = max(scores, key=lambda t: (scores[t], -t))
        if scores[best] == 0.0:
            return None
        step *= 0.5
        scores |= {t: score(t) for t in (best - step, best + step) if low <= t <= high and t not in scores}
    return max(scores, key=lambda t: (scores[t], -t))


def verify_moment(
    suspect: GaussianModel,
    opened: OpenedRecord,
    original: Moving,
    time: float | None = None,
    config: VerifyConfig | None = None,
) -> Verification:
    """Does this model, exported from a scene that moves, carry the mark?

    Parameters
    ----------
    suspect : GaussianModel
        With or without the Gaussians that are not visible at its moment.
    time : float, optional
        Its moment; looked for (`find_time`) where not given.

    Returns
    -------
    Verification
        Against the reference at that moment; against the canonical one if no moment was found.
    """
    shown = visible(suspect)
    if time is None:
        time = find_time(shown, opened, original, seed=(config or VerifyConfig()).seed)
    return verify_model(shown, opened if time is None else move_record(opened, original, time), config)


def verify_moving_images(
    images: Sequence[Float32],
    opened: OpenedRecord,
    original: Moving,
    times: Sequence[float],
    config: VerifyConfig | None = None,
    cameras: Sequence[Camera] | None = None,
    landmark_views: int = 24,
) -> tuple[Verification, float]:
    """Do these pictures of one moment show the marked scene?

    Parameters
    ----------
    images : sequence of (h, w, 3) float32
        All of the same moment.
    times : sequence of float
        The moments it may be; each is a try of the claim, and all are counted.
    cameras : sequence of Camera, optional
        One for each picture, where known.
    landmark_views : int
        Of the bank by which unknown cameras are found.

    Returns
    -------
    verification : Verification
        The best one, its bound multiplied by the number of moments.
    time : float
        Its moment.
    """
    if not times:
        raise InputError("no moment was given")
    config = config or VerifyConfig()
    config = replace(config, tries=max(config.tries or 1, len(times)))
    found: list[tuple[Verification, float]] = []
    for time in times:
        moved = move_record(opened, original, time, landmark_views=0 if cameras else landmark_views)
        found.append((verify_images(images, moved, config, cameras), time))
    return min(found, key=lambda pair: pair[0].claim.log10_false_claim)
