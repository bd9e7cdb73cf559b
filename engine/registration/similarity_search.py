"""Steps 1 to 3 of the registration: the similarity between the reference and a suspect, or its mirror image.

Features are invariant to mirroring, so both hands share one search for candidates; positions distinguish them, and one
test confirms either. Rotations stay proper all the way: it is the suspect that is mirrored.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations, product

import numpy as np
import numpy.typing as npt

from engine.model import Float64, GaussianModel
from engine.numerics.similarity import MIRROR, MIRROR_QUATS, mirror_model, quaternion_product
from engine.numerics.time_budget import UNLIMITED, TimeBudget
from engine.numerics.umeyama import Similarity, fit_noisy_source
from engine.registration.agreement import Verdict, confirm_similarity, same_order
from engine.registration.colored_points import are_points, place_points
from engine.registration.config import CONFIG, Agreement
from engine.registration.hypotheses import Hypothesis, propose
from engine.registration.looks_index import ReferenceIndex
from engine.registration.match_candidates import sample_rows

_CONFIG = CONFIG.similarity
BOTH = (False, True)
"""Whether mirrored; the suspect as it came is searched first."""


@dataclass(frozen=True, eq=False)
class Hands:
    """A suspect and its mirror image, which is made at first use."""

    suspect: GaussianModel

    @cached_property
    def _mirrored(self) -> GaussianModel:
        return mirror_model(self.suspect)

    @cached_property
    def _bare(self) -> "Hands":
        suspect = self.suspect
        return self if suspect.sh_degree == 0 else Hands(suspect.with_(sh=suspect.sh[:, :1]))

    def bare(self, mirrored: bool) -> GaussianModel:
        """The one or the other without its harmonics, where they are not needed: a tenth of the bytes to move."""
        return self._bare.of(mirrored)

    def of(self, mirrored: bool) -> GaussianModel:
        """The one or the other."""
        return self._mirrored if mirrored else self.suspect


def locate(
    index: ReferenceIndex,
    hands: Hands,
    rng: np.random.Generator,
    *,
    hands_searched: Sequence[bool] = BOTH,
    colorless: bool = True,
    budget: TimeBudget = UNLIMITED,
) -> tuple[Verdict | None, int]:
    """Where the reference is in a suspect, or in its mirror image: a similarity found right, and how many were weighed.

    `hands_searched`: mirrored or not, in order. `colorless`: search once more without colors.
    """
    tried = 0
    if len(index.model) == len(hands.suspect):
        tried += 1
        verdict = in_order(index, hands, hands_searched, rng)
        if verdict is not None:
            return verdict, tried
    verdict, count = _same_frame(index, hands, hands_searched, rng)
    tried += count
    if verdict is None:
        verdict, count = _by_points(index, hands, hands_searched, rng)
        tried += count
    if verdict is None:
        verdict, count = _search(index, hands, hands_searched, rng, colorless, budget)
        tried += count
    return verdict, tried


def in_order(
    index: ReferenceIndex, hands: Hands, hands_searched: Sequence[bool], rng: np.random.Generator
) -> Verdict | None:
    """Step 1: Gaussian i of a suspect of as many, or of its mirror image, is the reference's."""
    mirrored = _nearer_hand(index.model, hands, hands_searched, rng)
    verdict = same_order(index.model, hands.bare(mirrored), index.floor, rng)
    return None if verdict is None else replace(verdict, mirrored=mirrored)


def _nearer_hand(
    reference: GaussianModel, hands: Hands, hands_searched: Sequence[bool], rng: np.random.Generator
) -> bool:
    """The hand that lies nearer to the reference, were the order kept; a flat thing lies near with either."""
    rows = sample_rows(len(reference), _CONFIG.sample, rng)
    target, source = reference.means[rows], hands.suspect.means[rows]
    errors = []
    for mirrored in hands_searched:
        points = source * MIRROR if mirrored else source
        fit = fit_noisy_source(points, target)
        gap = np.inf if fit is None else float(np.median(np.linalg.norm(fit.apply(points) - target, axis=1)))
        errors.append(gap)
    return hands_searched[int(np.argmin(errors))]


def axis_rotations() -> list[Float64]:
    """The 24 proper rotations that map axes to axes, the identity first: what tools do to 'up'."""
    signs = [np.diag(s) for s in product((1.0, -1.0), repeat=3)]
    maps = [sign @ np.eye(3)[list(axes)] for axes in permutations(range(3)) for sign in signs]
    turns = [R for R in maps if np.linalg.det(R) > 0]
    return sorted(turns, key=lambda r: (-float(np.trace(r)), r.tolist()))


def _same_frame(
    index: ReferenceIndex, hands: Hands, hands_searched: Sequence[bool], rng: np.random.Generator
) -> tuple[Verdict | None, int]:
    """Step 2: no scale, no translation, at most a turn of the axes, and a mirror."""
    rows = sample_rows(len(hands.suspect), _CONFIG.glance, rng)
    part = hands.bare(False).take(rows)
    quarter = axis_rotations()
    hits: list[int] = []
    for mirrored in hands_searched:
        seen = mirror_model(part) if mirrored else part
        for R in quarter:
            matched = index.matcher.match(seen, Similarity(1.0, R, np.zeros(3)))
            hits.append(int((matched.index >= 0).sum()))
            if len(hits) == 1 and hits[0] > 0.5 * len(rows):
                break
        if max(hits) > 0.5 * len(rows):
            break
    best = int(np.argmax(hits))
    if hits[best] < max(_CONFIG.least_matches, 0.01 * len(rows)):
        return None, len(hits)
    fit = Similarity(1.0, quarter[best % len(quarter)], np.zeros(3))
    return _confirm(index, hands, hands_searched[best // len(quarter)], fit, None, rng), len(hits)


def _by_points(
    index: ReferenceIndex, hands: Hands, hands_searched: Sequence[bool], rng: np.random.Generator
) -> tuple[Verdict | None, int]:
    """Step 3 for a cloud of colored points, which have no looks of their own."""
    if not are_points(hands.suspect):
        return None, 0
    for tried, mirrored in enumerate(hands_searched, start=1):
        placed = place_points(index.model, hands.suspect, mirrored, rng)
        verdict = None if placed is None else _confirm(index, hands, mirrored, *placed, rng)
        if verdict is not None:
            return verdict, tried
    return None, len(hands_searched)


def _search(
    index: ReferenceIndex,
    hands: Hands,
    hands_searched: Sequence[bool],
    rng: np.random.Generator,
    colorless: bool,
    budget: TimeBudget,
) -> tuple[Verdict | None, int]:
    """Step 3: candidates, agreement, triples."""
    suspect = hands.suspect
    degree = min(index.model.sh_degree, suspect.sh_degree)
    tried = 0
    stages = [(True, False), (True, True)] + ([(False, False)] if colorless else [])
    for colors, deep in stages:
        queries = (10 if deep else 2) * _CONFIG.candidates
        if deep and len(suspect) <= queries // 5:
            continue  # the shallow search had them all
        if not budget.allows("similarities"):
            break
        looks = index.features(degree, colors=colors)
        pairs = looks.candidates(suspect, _CONFIG.candidates, rng, queries=queries, deep=deep)
        votes = np.exp(pairs.size)
        pairs = pairs.take((votes >= _CONFIG.min_scale / 2) & (votes <= _CONFIG.max_scale * 2))
        theirs = index.model.quats[pairs.reference], suspect.quats[pairs.suspect]
        for level in (_CONFIG.exact, _CONFIG.loose):
            for agreement in (level, Agreement(level.size, level.edge, np.inf)):
                scene, seed = (index.extent, index.chance), int(rng.integers(2**31))
                credible: list[tuple[Hypothesis, bool]] = []
                for mirrored in hands_searched:
                    seen, turn = pairs.mirrored() if mirrored else pairs, turns(*theirs, mirrored)
                    hypotheses, count = propose(
                        seen, turn, agreement, *scene, seeds=_CONFIG.seeds, draws=_CONFIG.draws, seed=seed
                    )
                    tried += count
                    credible += [(h, mirrored) for h in hypotheses[:2] if _credible(h)]
                # A flat or noisy thing is explained by either hand, but by its own far better.
                for h, mirrored in sorted(credible, key=lambda each: -each[0].evidence):
                    inliers = (pairs.reference[h.inliers], pairs.suspect[h.inliers])
                    verdict = _confirm(index, hands, mirrored, h.fit, inliers, rng)
                    if verdict is not None:
                        return verdict, tried
    return None, tried


def turns(reference: npt.NDArray[np.float32], suspect: npt.NDArray[np.float32], mirrored: bool) -> Float64:
    """(n, 4) how each pair's suspect Gaussian, or its mirror image, turned."""
    conjugate = np.array([1, -1, -1, -1]) * (suspect * MIRROR_QUATS if mirrored else suspect)
    return quaternion_product(reference, conjugate)


def _credible(hypothesis: Hypothesis) -> bool:
    """Whether it is worth testing."""
    return (
        hypothesis.evidence >= _CONFIG.least_evidence and _CONFIG.min_scale <= hypothesis.fit.scale <= _CONFIG.max_scale
    )


def _confirm(
    index: ReferenceIndex,
    hands: Hands,
    mirrored: bool,
    fit: Similarity,
    inliers: tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]] | None,
    rng: np.random.Generator,
) -> Verdict | None:
    suspect = hands.bare(mirrored)
    rows = sample_rows(len(suspect), _CONFIG.sample, rng)
    verdict = confirm_similarity(
        index.model, suspect, fit, inliers, rows, index.matcher, rng, min_matches=_CONFIG.least_matches
    )
    return None if verdict is None else replace(verdict, mirrored=mirrored)
