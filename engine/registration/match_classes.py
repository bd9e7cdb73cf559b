"""Errors that grow with the Gaussians: noise in proportion to a Gaussian's size moves the large ones far.

One error for all would be too small for the large ones and too large for the small ones. So the Gaussians are matched
in classes of like size, each with errors of its own, learnt as the others are: from the matches, until they settle.
Within a class, and along the axes of each, errors differ still: the larger ones count (`estimate_wide`).
"""

from dataclasses import dataclass, replace

import numpy as np

from engine.model import Float32, Float64, GaussianModel, Int32, Int64
from engine.numerics.umeyama import Similarity
from engine.registration.config import CONFIG
from engine.registration.match_candidates import sample_rows
from engine.registration.matching import Deviations, Matcher, estimate_wide, log_sizes

_CONFIG = CONFIG.classes


@dataclass(frozen=True, eq=False)
class SizedMatcher:
    """A reference laid out in classes of size, each for errors of its own: `edges` (K - 1,) log sizes between the
    classes, `rows` the reference's Gaussians in each, ready to be matched by its matcher."""

    edges: Float64
    rows: tuple[Int64, ...]
    matchers: tuple[Matcher, ...]

    def pair(self, suspect: GaussianModel, fit: Similarity, deviations: Deviations) -> tuple[Int32, Float32]:
        """As `Matcher.pair`; of the deviations only the colour change is used."""
        matches, quality = np.full(len(suspect), -1, np.int32), np.zeros(len(suspect), np.float32)
        home = np.searchsorted(self.edges, log_sizes(suspect, fit))
        for number, (rows, matcher) in enumerate(zip(self.rows, self.matchers, strict=True)):
            mine = np.flatnonzero(home == number)
            found, quality[mine] = matcher.pair(suspect.take(mine), fit, deviations)
            matches[mine] = np.where(found >= 0, rows[found], -1)
        return matches, quality


def by_size(
    reference: GaussianModel,
    suspect: GaussianModel,
    fit: Similarity,
    deviations: Deviations,
    floor: Deviations,
    rng: np.random.Generator,
    *,
    in_order: bool,
) -> SizedMatcher | None:
    """The reference laid out in classes of size for a suspect whose place and errors are known; None where the errors
    do not grow with size.

    `floor` are the errors below which nothing is measured; `in_order`: row for row the partners are known.
    """
    own, theirs = log_sizes(reference, Similarity.identity()), log_sizes(suspect, fit)
    edges = np.quantile(theirs, np.arange(1, _CONFIG.count) / _CONFIG.count)
    home = np.searchsorted(edges, theirs)
    margin = 3.0 * float(deviations.size[2])
    rows: list[Int64] = []
    learnt: list[Deviations] = []
    begin, before = deviations, np.inf  # what the class of the next smaller ones came to, and their size
    for number in range(_CONFIG.count):
        low, high = (np.concatenate([[-np.inf], edges, [np.inf]]))[number : number + 2]
        alike = np.flatnonzero((own >= low - margin) & (own <= high + margin))
        # strangers may be of sizes that the reference has not
        rows.append(alike if len(alike) >= _CONFIG.least_pairs else np.arange(len(reference)))
        mine = np.flatnonzero(home == number)
        sampled = mine[sample_rows(len(mine), _CONFIG.sample, rng)]
        part = suspect.take(sampled)
        typical = float(np.median(theirs[mine])) if len(mine) else before
        grown = begin.position * np.exp(max(0.0, typical - before))
        begin = replace(begin, position=np.maximum(deviations.position, grown))
        if in_order:
            found = _compare(reference.take(sampled), part, fit, floor)
        else:
            found = _learn(reference.take(rows[-1]), part, fit, begin, floor)
        learnt.append(found or deviations)
        begin, before = found or begin, typical
    means = np.array([np.log(d.position).mean() for d in learnt])
    if means.max() - means.min() < np.log(_CONFIG.growth):
        return None
    return SizedMatcher(
        edges, tuple(rows), tuple(Matcher(reference.take(r), d) for r, d in zip(rows, learnt, strict=True))
    )


def _learn(
    reference: GaussianModel, part: GaussianModel, fit: Similarity, start: Deviations, floor: Deviations
) -> Deviations | None:
    """Errors of one class; None where they are not to be learnt, or grow beyond belief."""
    if len(reference) < _CONFIG.least_pairs or not len(part):
        return None
    limit = _limit(part, fit)
    deviations = start
    for _ in range(_CONFIG.rounds):
        pairs = Matcher(reference, deviations).match(part, fit, deviations).pairs
        if len(np.unique(pairs[0])) < _CONFIG.least_pairs:
            return None
        measured = estimate_wide(reference, part, pairs, fit, floor)
        if (measured.position > np.maximum(limit, start.position)).any():
            return None
        settled = not (measured.much_above(deviations, 1.1) or deviations.much_above(measured, 1.5))
        deviations = measured
        if settled:
            break
    return deviations


def _compare(reference: GaussianModel, part: GaussianModel, fit: Similarity, floor: Deviations) -> Deviations | None:
    """`growth` where row for row the partners are known; what lies too far off is something else, unless most does."""
    if not len(part):
        return None
    error = np.abs(fit.apply(part.means) - reference.means)
    near = np.flatnonzero((error <= _limit(part, fit)).all(axis=1))
    if len(near) < max(_CONFIG.least_pairs, len(part) / 2):
        return None
    return estimate_wide(reference, part, (near, near), fit, floor)


def _limit(part: GaussianModel, fit: Similarity) -> float:
    """The largest error that is believed."""
    return _CONFIG.own_size * float(np.exp(np.median(log_sizes(part, Similarity.identity())) + np.log(fit.scale)))
