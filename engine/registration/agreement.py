"""Confirms a hypothesis: a similarity is refined, its errors are measured, and it must explain more than decoys."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.model import Float32, GaussianModel, Int32
from engine.numerics.similarity import quaternion_to_rotation
from engine.numerics.umeyama import Similarity, fit_noisy_source
from engine.registration.config import CONFIG
from engine.registration.match_classes import SizedMatcher
from engine.registration.matching import Deviations, Matcher, clipped_at, estimate_deviations

_CONFIG = CONFIG.confirmation


@dataclass(frozen=True, eq=False)
class Verdict:
    """A similarity that was found right, its measured errors and the global change of colour.

    `matcher` lays the reference out for these errors. Where the order was kept, suspect Gaussian i is reference
    Gaussian i, `order_quality` (M,) is the trust in each pair, and the matcher is for those with none; it is None where
    all have some. `mirrored`: all this is of the suspect's mirror image.
    """

    fit: Similarity
    matcher: Matcher | SizedMatcher | None
    deviations: Deviations
    order_quality: Float32 | None = None
    mirrored: bool = False

    def match(self, suspect: GaussianModel) -> tuple[Int32, Float32]:
        """(M,) reference Gaussian of each Gaussian of the suspect, or of its mirror image, -1 where there is none, and
        the trust in it, 0 to 1."""
        matches, quality = np.full(len(suspect), -1, np.int32), np.zeros(len(suspect), np.float32)
        if self.order_quality is not None:
            quality = self.order_quality.copy()
            matches = np.where(quality > 0, np.arange(len(suspect)), -1).astype(np.int32)
        if self.matcher is not None:
            left = np.flatnonzero(matches < 0)
            rest = suspect if len(left) == len(suspect) else suspect.take(left)
            matches[left], quality[left] = self.matcher.pair(rest, self.fit, self.deviations)
        return matches, quality


def confirm_similarity(
    reference: GaussianModel,
    suspect: GaussianModel,
    fit: Similarity,
    inliers: tuple[npt.NDArray[Any], npt.NDArray[Any]] | None,
    rows: npt.NDArray[np.int64],
    floor_matcher: Matcher,
    rng: np.random.Generator,
    *,
    min_matches: int,
) -> Verdict | None:
    """Refine a hypothesis and accept it; None if it explains no more than its decoys.

    `inliers`: reference and suspect index (k,) of the pairs that support it; the suspect's noise is measured on them.
    `rows` (s,): sample of suspect Gaussians, of which at least `min_matches` distinct reference Gaussians must be
    matched. `floor_matcher`: the reference laid out for the smallest errors. `rng` draws the decoys.
    """
    floor = replace(floor_matcher.deviations, smallest=clipped_at(reference, suspect, fit))
    deviations = floor
    if inliers is not None:
        measured = estimate_deviations(reference, suspect, inliers, fit, floor)
        if measured.much_above(floor, 1.5):
            # Candidates are pairs that look alike: their errors are too small by selection.
            deviations = measured
    spread = reference.means[:: max(1, len(reference) // 20_000)].std(axis=0, dtype=np.float64)
    if not _distinguishes(deviations, spread):
        return None
    as_laid_out = deviations is floor and floor.smallest == floor_matcher.deviations.smallest
    matcher = floor_matcher if as_laid_out else Matcher(reference, deviations)
    part = suspect.take(rows)
    if inliers is not None and len(rows) > 4 * _CONFIG.glance:
        glance = part.take(np.arange(0, len(rows), len(rows) // _CONFIG.glance))
        if not beats_decoys(reference, glance, matcher, fit, deviations, rng, 1.5, 2.0):
            return None
    refined = _refine(reference, part, fit, matcher, deviations, floor, spread, min_matches)
    if refined is None:
        return None
    fit, matcher, deviations = refined
    beats = beats_decoys(reference, part, matcher, fit, deviations, rng, 2.0, min_matches - 1.0)
    return Verdict(fit, matcher, deviations) if beats else None


def _refine(
    reference: GaussianModel,
    part: GaussianModel,
    fit: Similarity,
    matcher: Matcher,
    deviations: Deviations,
    floor: Deviations,
    spread: npt.NDArray[np.float64],
    min_matches: int,
) -> tuple[Similarity, Matcher, Deviations] | None:
    """Match, fit and measure errors until these settle; None where too few Gaussians match, or errors get as large as
    the model."""
    pairs = matcher.match(part, fit, deviations).pairs
    for _ in range(_CONFIG.rounds):
        if len(np.unique(pairs[0])) < min_matches:  # copies of one Gaussian support a similarity once
            return None
        better = fit_noisy_source(part.means[pairs[1]], reference.means[pairs[0]], start=fit)
        if better is None:
            return None
        fit = better
        measured = estimate_deviations(reference, part, pairs, fit, floor)
        if not _distinguishes(measured, spread):
            return None
        settled = not (measured.much_above(matcher.deviations, 1.25) or matcher.deviations.much_above(measured, 2.0))
        deviations = measured
        if not settled:
            matcher = Matcher(reference, deviations)
        pairs = matcher.match(part, fit, deviations).pairs
        if settled:
            break
    return (fit, matcher, deviations) if len(np.unique(pairs[0])) >= min_matches else None


def _distinguishes(deviations: Deviations, spread: npt.NDArray[np.float64]) -> bool:
    """Whether errors are clearly below the model's spread, which errors of random pairs have."""
    share = deviations.position / np.maximum(spread, deviations.position)
    return bool(np.exp(np.log(share).mean()) < 0.3)


def beats_decoys(
    reference: GaussianModel,
    part: GaussianModel,
    matcher: Matcher,
    fit: Similarity,
    deviations: Deviations,
    rng: np.random.Generator,
    factor: float,
    margin: float,
) -> bool:
    """Whether the similarity explains clearly more than others, turned wrongly about its middle."""
    right = matcher.match(part, fit, deviations)
    explained = float(right.probability.sum())
    if explained <= margin:
        return False
    middle = np.median(reference.means[right.index[right.index >= 0]].astype(np.float64), axis=0)
    for _ in range(_CONFIG.decoys):
        axis = rng.normal(size=3)
        half = 0.5 * rng.uniform(0.5, 2.5)
        turn = quaternion_to_rotation([np.cos(half), *(np.sin(half) / np.linalg.norm(axis) * axis)])
        decoy = Similarity(fit.scale, turn @ fit.R, turn @ (fit.t - middle) + middle)
        by_chance = float(matcher.match(part, decoy, deviations).probability.sum())
        if explained < factor * by_chance + margin:
            return False
    return True
