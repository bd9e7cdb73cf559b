"""Gaussians whose order was kept: row for row the partners are known, and only errors are to be measured."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from engine.model import Bool, Float32, Float64, GaussianModel
from engine.numerics.chi_square import chi_square_beyond
from engine.numerics.umeyama import Similarity, fit_noisy_source
from engine.registration.agreement import Verdict
from engine.registration.config import CONFIG
from engine.registration.match_candidates import sample_rows
from engine.registration.matching import (
    HARD,
    Deviations,
    Matcher,
    clipped_at,
    estimate_deviations,
    joint_pairs,
    log_sizes,
)

_CONFIG, _CLASSES = CONFIG.order, CONFIG.classes


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
    near = alike & (error <= _CLASSES.own_size).all(axis=1)
    edges = np.quantile(sizes, np.arange(1, _CLASSES.count) / _CLASSES.count)
    home = np.searchsorted(edges, sizes)
    parts = np.zeros(_CLASSES.count)
    for number in range(_CLASSES.count):
        mine = error[near & (home == number)]
        if len(mine) >= _CLASSES.least_pairs:
            parts[number] = float(np.quantile(mine, 0.9, axis=0).max()) / 1.645
    return Growth(edges, parts)


def same_order(
    reference: GaussianModel, suspect: GaussianModel, floor: Deviations, rng: np.random.Generator
) -> Verdict | None:
    """Whether Gaussian i of the suspect is Gaussian i of the reference, however noisy.

    Two scenes sorted along the same space-filling curve agree roughly in position by accident. So the pairs
    must agree in size, opacity and colour, too, by far better than shuffled pairs do.
    """
    rows = sample_rows(len(reference), _CONFIG.sample, rng)
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
    if _moved_up(reference, suspect, rows) > _CONFIG.moved_up:
        return None
    before = 0
    for _ in range(_CONFIG.rounds):
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
    matcher = None if strays <= _CONFIG.strays else Matcher(reference, deviations)
    return Verdict(fit, matcher, deviations, quality)


def _moved_up(reference: GaussianModel, suspect: GaussianModel, rows: npt.NDArray[np.int64]) -> float:
    """Share of rows of which a neighbor in the reference's order looks far more alike than their own partner.

    A file sorted along a curve, and sorted again after every center moved a little, keeps its order but for a few
    places everywhere: partners then lie near each other and look alike, as a noisy copy's do.
    """
    theirs = _own_looks(suspect, rows)
    apart = np.square(_own_looks(reference, rows) - theirs).sum(axis=1)
    nearest = np.full(len(rows), np.inf)
    for step in (*range(-_CONFIG.reach, 0), *range(1, _CONFIG.reach + 1)):
        shifted = rows + step
        inside = (shifted >= 0) & (shifted < len(reference))
        gap = np.square(_own_looks(reference, np.where(inside, shifted, 0)) - theirs).sum(axis=1)
        nearest = np.where(inside, np.minimum(nearest, gap), nearest)
    return float((nearest < _CONFIG.far_more_alike * apart).mean())


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
