"""Confirms a hypothesis: a similarity is refined, its errors are measured, and it must explain more than decoys."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.model import Bool, Float32, Float64, GaussianModel, Int32
from engine.numerics.chi_square import chi_square_beyond
from engine.numerics.similarity import quaternion_to_rotation
from engine.numerics.umeyama import Similarity, fit_noisy_source
from engine.registration.config import CONFIG
from engine.registration.match_candidates import sample_rows
from engine.registration.match_classes import SizedMatcher
from engine.registration.matching import (
    HARD,
    Deviations,
    Matcher,
    clipped_at,
    estimate_deviations,
    joint_pairs,
    log_sizes,
)

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


@dataclass(frozen=True, eq=False)
class Growth:
    """By how much errors of position grow with the Gaussians: `edges` (K - 1,) log sizes between classes, `parts` (K,)
    of its own size by which a Gaussian of each is off."""

    edges: Float64
    parts: Float64

    def factors(self, suspect: GaussianModel, fit: Similarity, deviations: Deviations) -> Float32:
        """(n, 3) what the usual errors of position are to be multiplied with, 1 or more."""
        sizes = log_sizes(suspect, fit)
        own = self.parts[np.searchsorted(self.edges, sizes)] * np.exp(sizes)
        return np.asarray(np.maximum(own[:, None] / deviations.position, 1.0).astype(np.float32))


def growth_in_order(reference: GaussianModel, suspect: GaussianModel, fit: Similarity, alike: Bool) -> Growth:
    """How much farther larger Gaussians are moved, from rows that are each other's partners where they are `alike`.

    Only pairs within `own_size` count: a row that looks like its partner elsewhere is another Gaussian.
    """
    sizes = log_sizes(suspect, fit)
    error = np.abs(fit.apply(suspect.means) - reference.means) / np.exp(sizes)[:, None]
    near = alike & (error <= CONFIG.classes.own_size).all(axis=1)
    edges = np.quantile(sizes, np.arange(1, CONFIG.classes.count) / CONFIG.classes.count)
    home = np.searchsorted(edges, sizes)
    parts = np.zeros(CONFIG.classes.count)
    for number in range(CONFIG.classes.count):
        mine = error[near & (home == number)]
        if len(mine) >= CONFIG.classes.least_pairs:
            parts[number] = float(np.quantile(mine, 0.9, axis=0).max()) / 1.645
    return Growth(edges, parts)


def same_order(
    reference: GaussianModel, suspect: GaussianModel, floor: Deviations, rng: np.random.Generator
) -> Verdict | None:
    """Whether Gaussian i of the suspect is Gaussian i of the reference, however noisy.

    Two scenes sorted along the same space-filling curve agree roughly in position by accident. So the pairs
    must agree in size, opacity and colour, too, by far better than shuffled pairs do.
    """
    rows = sample_rows(len(reference), CONFIG.order.sample, rng)
    ref, sus = reference.take(rows), suspect.take(rows)
    fit = fit_noisy_source(sus.means, ref.means)
    if fit is None:
        return None
    floor = replace(floor, smallest=clipped_at(reference, suspect, fit))
    deviations = estimate_deviations(reference, suspect, (rows, rows), fit, floor)
    a, b = joint_pairs(ref, sus, fit, deviations)
    right = np.median(np.abs(a - b), axis=0)
    wrong = np.median(np.abs(a - b[rng.permutation(len(rows))]), axis=0)
    groups = (slice(0, 3), slice(3, 6), slice(6, 7), slice(7, 10))
    # 2: a group whose shuffled pairs lie as close as the smallest errors carries no information
    informative = [float(wrong[g].max()) > 2.0 for g in groups]
    agrees = [float(right[g].mean()) < 0.5 * float(wrong[g].mean()) for g in groups]
    looks = [yes for yes, counts in zip(agrees[1:], informative[1:], strict=True) if counts]
    if not (informative[0] and agrees[0]) or not looks or sum(looks) < min(2, len(looks)):
        return None
    if _moved_up(reference, suspect, rows) > CONFIG.order.moved_up:
        return None
    before = 0
    for _ in range(CONFIG.order.rounds):
        agreeing = rows[_order_quality(ref, sus, fit, deviations) > 0]
        if len(agreeing) in (len(rows), before):
            break
        before = len(agreeing)
        fit = fit_noisy_source(suspect.means[agreeing], reference.means[agreeing], start=fit) or fit
        deviations = estimate_deviations(reference, suspect, (agreeing, agreeing), fit, floor)
    growth = growth_in_order(ref, sus, fit, _order_quality(ref, sus, fit, deviations, placed=False) > 0)
    quality = _order_quality(reference, suspect, fit, deviations, growth)
    # A file sorted along a curve, and sorted again after it was turned a little, keeps half of its order.
    strays = float((quality == 0).mean())
    matcher = None if strays <= CONFIG.order.strays else Matcher(reference, deviations)
    return Verdict(fit, matcher, deviations, quality)


def _moved_up(reference: GaussianModel, suspect: GaussianModel, rows: npt.NDArray[np.int64]) -> float:
    """Share of rows of which a neighbor in the reference's order looks far more alike than their own partner.

    A file sorted along a curve, and sorted again after every center moved a little, keeps its order but for a few
    places everywhere: partners then lie near each other and look alike, as a noisy copy's do.
    """
    theirs = _own_looks(suspect, rows)
    apart = np.square(_own_looks(reference, rows) - theirs).sum(axis=1)
    nearest = np.full(len(rows), np.inf)
    for step in (*range(-CONFIG.order.reach, 0), *range(1, CONFIG.order.reach + 1)):
        shifted = rows + step
        inside = (shifted >= 0) & (shifted < len(reference))
        gap = np.square(_own_looks(reference, np.where(inside, shifted, 0)) - theirs).sum(axis=1)
        nearest = np.where(inside, np.minimum(nearest, gap), nearest)
    return float((nearest < CONFIG.order.far_more_alike * apart).mean())


def _own_looks(model: GaussianModel, rows: npt.NDArray[np.int64]) -> Float32:
    """(n, 7) sorted log scales, opacity logit and DC colors of some rows."""
    sizes = np.sort(model.log_scales[rows], axis=1)
    return np.concatenate([sizes, model.opacity_logits[rows, None], model.sh[rows, 0]], axis=1)


def _order_quality(
    reference: GaussianModel,
    suspect: GaussianModel,
    fit: Similarity,
    deviations: Deviations,
    growth: Growth | None = None,
    *,
    placed: bool = True,
) -> Float32:
    """(n,) trust 0..1 that suspect Gaussian i is reference Gaussian i, by where it lies only if `placed`.

    `growth`: by how much errors of position grow with the Gaussians.
    """
    a, b = joint_pairs(reference, suspect, fit, deviations)
    error2 = np.square(a - b)
    if not placed:
        error2[:, :3] = 0.0
    elif growth is not None:
        error2[:, :3] /= np.square(growth.factors(suspect, fit, deviations))
    usual, limit = chi_square_beyond(10, 0.5), 4.0 * chi_square_beyond(10, 1e-3)
    distance2 = error2[:, :HARD].sum(axis=1) + np.minimum(error2[:, HARD:].sum(axis=1), 0.5 * limit)
    return np.asarray(np.clip((limit - distance2) / (limit - usual), 0.0, 1.0).astype(np.float32))
