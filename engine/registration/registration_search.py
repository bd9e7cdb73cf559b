"""Finding the reference in a suspect model, whatever similarity, mirror, shuffle, cut, copy or noise it went through.

The steps, cheapest first; `agreement.confirm_similarity` tests the hypotheses of each:

1. same order: as many Gaussians as the reference has, each looking like its namesake;
2. same frame: the reference's coordinates, or turned by a multiple of 90 degrees about the axes;
3. search: candidates that look alike, agreement among them, triples (`hypotheses`);
   with colours, exact then loose; then with more queries, for a small piece in a large foreign scene; then
   without colours, for a recoloured model;
4. merging: where Gaussians are left over, or none was found, mixtures of the reference's (`merged`);
5. deformation: where no similarity is the whole story, small patches and what grows from them
   (`deformed`).

Steps 1 to 3 (`similarity_search`) search the suspect as it came and its mirror image; the maps of step 4 may mirror.

Nothing here knows the secret of the mark: only the unmarked reference and the suspect enter. So one
registration is one hypothesis of the claim, however many alignments were weighed; their number is reported
all the same.
"""

from dataclasses import dataclass, replace

import numpy as np

from engine.model import Bool, Float32, Float64, GaussianModel, Int32, Int64
from engine.numerics.similarity import mirror_model, transform_model
from engine.numerics.time_budget import UNLIMITED, TimeBudget
from engine.numerics.umeyama import Similarity
from engine.registration.agreement import Verdict, fit_suspect
from engine.registration.deformed import GAIN, register_deformed, unexplained
from engine.registration.looks_index import ReferenceIndex
from engine.registration.match_classes import by_size
from engine.registration.merged import TRUSTED, register_merged
from engine.registration.mixtures import Mixtures
from engine.registration.similarity_search import BOTH, MAX_SCALE, MIN_SCALE, Hands, axis_rotations, in_order, locate
from engine.registration.visibility import drawn

FIT_SAMPLE = 50_000
"""Matched pairs from which the similarity is fitted in the end."""
EXPLAINED = 0.97
"""Mean trust in the matches below which errors are sought that grow with the Gaussians."""
MOSTLY = 0.5
"""Share of the suspect that one hand must explain, or what is left over is looked at with the other hand, too."""
LEAST_REST = 64
"""Gaussians below which nothing is looked for in what is left over: as few as a mark needs."""
LEFT_OVER = 0.02
"""Share of the suspect's Gaussians without a match from which merged Gaussians are searched among them: a voxel
tree makes many into few."""


@dataclass(frozen=True)
class RegistrationConfig:
    """What the registration looks for."""

    colorless: bool = True  # search once more without colours, which costs time where nothing is found
    merged: bool = True  # look for mixtures where single Gaussians are left over
    deformed: bool = True  # look for a deformation where no similarity is the whole story


@dataclass(frozen=True, eq=False)
class Registration:
    """Where the reference is in the suspect, or in its mirror image: x_reference = scale * R @ x_suspect + t. Where it
    was not found, the similarity is the identity, and nothing is matched."""

    scale: float
    R: Float64  # (3, 3) proper rotation
    t: Float64
    matches: Int32  # (M,) reference Gaussian of each suspect Gaussian, -1 where there is none
    match_quality: Float32  # (M,) trust in each match, 0..1; 0 where there is none
    derived_fraction: float  # share of the reference's Gaussians that were found
    found: bool  # whether the suspect holds a piece of the reference
    hypotheses_tried: int  # alignments weighed, at least 1; they were chosen without the chips
    deformed: bool = False  # the matches come from a field of local maps; the similarity is the nearest single one
    # The suspect is a mirror image: `similarity` takes its own, `mirror_model` of it, to the reference. Matches tell
    # rows, which are the same in both.
    mirrored: bool = False
    mixed: Mixtures | None = None  # where suspect Gaussians are merged ones: all that was found, the matches among it
    undrawn: int = 0  # Gaussians of the suspect that no viewer draws, left out beforehand: they are matched to none

    @property
    def similarity(self) -> Similarity:
        """Scale, R and t as one value."""
        return Similarity(self.scale, self.R, self.t)

    def place(self, suspect: GaussianModel) -> GaussianModel:
        """The suspect, or a part of it, where the reference lies: mirrored first if it is a mirror image."""
        seen = mirror_model(suspect) if self.mirrored else suspect
        return transform_model(seen, self.scale, self.R, self.t)

    @property
    def mixtures(self) -> Mixtures:
        """Which reference Gaussians each suspect Gaussian is made of; a plain match is a mixture of one."""
        return self.mixed or Mixtures.of_matches(self.matches, self.match_quality)


def register(
    reference: GaussianModel | ReferenceIndex,
    suspect: GaussianModel,
    *,
    seed: int = 0,
    config: RegistrationConfig = RegistrationConfig(),
    budget: TimeBudget = UNLIMITED,
) -> Registration:
    """Find the reference, or pieces of it, in a suspect model.

    The reference is the unmarked one; an index serves many suspects. The same seed, of the samples and triples drawn,
    gives the same answer, unless the budget ends a search: then whole steps are left out, and no step gives less.
    `found` is False if the suspect holds no recognizable piece; that is an answer, not an error.
    """
    index = reference if isinstance(reference, ReferenceIndex) else ReferenceIndex(reference)
    seen = drawn(suspect)
    # The reference may have Gaussians that nobody sees, too, and gave as many, in the mean, to any part of it.
    if seen.all() or seen.mean() >= index.drawn.mean():
        return _register(index, suspect, seed, config, budget)
    if len(index.model) == len(suspect) and len(suspect) >= 3:
        rng = np.random.default_rng(seed)
        if in_order(index, Hands(suspect), BOTH, rng) is not None:  # it would be lost with the rows
            return _without(_register(index, suspect, seed, config, budget), ~seen & index.drawn, index)
    return _spread(_register(index, suspect.take(seen), seed, config, budget), np.flatnonzero(seen), len(suspect))


def _without(found: Registration, rows: Bool, index: ReferenceIndex) -> Registration:
    """The same but for some rows (M,), which are taken for nothing."""
    matches, quality = np.where(rows, np.int32(-1), found.matches), np.where(rows, np.float32(0.0), found.match_quality)
    mixed = None if found.mixed is None else replace(found.mixed, quality=np.where(rows, 0.0, found.mixed.quality))
    share = found.derived_fraction if mixed is not None else _found(index.model, matches)
    told = {"derived_fraction": share, "undrawn": int(rows.sum())}
    return replace(found, matches=matches, match_quality=quality, mixed=mixed, **told)


def _spread(found: Registration, rows: Int64, m: int) -> Registration:
    """What was found in some rows of a suspect of m Gaussians, told in the whole suspect's rows."""
    matches, quality = np.full(m, -1, np.int32), np.zeros(m, np.float32)
    matches[rows], quality[rows] = found.matches, found.match_quality
    mixed = found.mixed
    if mixed is not None:
        trust = np.zeros(m, np.float32)
        trust[rows] = mixed.quality
        mixed = replace(mixed, suspect_rows=rows[mixed.suspect_rows].astype(np.int32), quality=trust)
    return replace(found, matches=matches, match_quality=quality, mixed=mixed, undrawn=m - len(rows))


def _register(
    index: ReferenceIndex, suspect: GaussianModel, seed: int, config: RegistrationConfig, budget: TimeBudget
) -> Registration:
    n, m = len(index.model), len(suspect)
    if n < 3 or m < 3:
        return _nothing(m, 1)
    rng = np.random.default_rng(seed)
    hands = Hands(suspect)
    verdict, tried = locate(index, hands, rng, colorless=config.colorless, budget=budget)
    either = [(_nothing(m, tried) if verdict is None else _answer(index, hands, verdict, tried, rng), verdict)]
    if verdict is not None:
        others, weighed = _other_hand(index, hands, either[0][0], rng, budget)
        either += others
        tried += weighed
    if config.merged:
        either = [(_unmerge(index, hands, rigid, rng, budget), found) for rigid, found in either]
    # A thing as symmetric as a pot lies in its mirror image, too: which explains more shows when all is explained.
    rigid, verdict = max(either, key=lambda one: float(one[0].mixtures.quality.sum()))
    rigid = replace(rigid, hypotheses_tried=max(tried, *(one.hypotheses_tried for one, _ in either)))
    return _bend(index, hands, rigid, verdict, rng, budget) if config.deformed else rigid


def _nothing(m: int, tried: int) -> Registration:
    unmatched = np.full(m, -1, np.int32), np.zeros(m, np.float32)
    return Registration(1.0, np.eye(3), np.zeros(3), *unmatched, 0.0, False, max(1, tried))


def _answer(
    index: ReferenceIndex, hands: Hands, verdict: Verdict, tried: int, rng: np.random.Generator
) -> Registration:
    """The registration that follows from a verdict: every suspect Gaussian is matched."""
    suspect = hands.bare(verdict.mirrored)
    matches, quality = verdict.match(suspect)
    if quality.mean() < EXPLAINED:
        in_order = verdict.order_quality is not None
        sized = by_size(index.model, suspect, verdict.fit, verdict.deviations, index.floor, rng, in_order=in_order)
        again = (matches, quality) if sized is None else replace(verdict, matcher=sized).match(suspect)
        if again[1].sum() > quality.sum():
            matches, quality = again
    rows = np.flatnonzero(matches >= 0)
    fit = verdict.fit
    if verdict.order_quality is None and len(rows) > 3:
        part = rows[:: max(1, len(rows) // FIT_SAMPLE)]
        fit = fit_suspect(suspect.means[part], index.model.means[matches[part]], start=fit) or fit
    share = _found(index.model, matches)
    return Registration(fit.scale, fit.R, fit.t, matches, quality, share, True, tried, mirrored=verdict.mirrored)


def _other_hand(
    index: ReferenceIndex, hands: Hands, rigid: Registration, rng: np.random.Generator, budget: TimeBudget
) -> tuple[list[tuple[Registration, Verdict | None]], int]:
    """The registration with the other hand, if there is one, where this one leaves much over: a small piece left as it
    was hides no mirror. And how many alignments were weighed."""
    left = np.flatnonzero(rigid.matches < 0)
    if len(left) < max(LEAST_REST, (1.0 - MOSTLY) * len(rigid.matches)) or not budget.allows("the other hand"):
        return [], 0
    rest = Hands(hands.suspect.take(left))
    other, count = locate(index, rest, rng, hands_searched=(not rigid.mirrored,), colorless=False, budget=budget)
    if other is None or other.order_quality is not None:
        return [], count
    return [(_answer(index, hands, other, rigid.hypotheses_tried + count, rng), other)], count


def _found(reference: GaussianModel, matches: Int32) -> float:
    """Share of the reference's Gaussians that are among the matches."""
    seen = np.zeros(len(reference), np.bool_)
    seen[matches[matches >= 0]] = True
    return float(seen.mean())


def _unmerge(
    index: ReferenceIndex, hands: Hands, plain: Registration, rng: np.random.Generator, budget: TimeBudget
) -> Registration:
    """Step 4: the registration by mixtures, where they explain clearly more than plain matches."""
    if (plain.matches < 0).mean() <= LEFT_OVER or not budget.allows("merged Gaussians"):
        return plain
    starts: list[tuple[bool, Similarity | None]] = [(False, None), (True, None)]
    if plain.found:
        # Where few are matched well, the place may be wrong itself.
        starts = [(plain.mirrored, plain.similarity), *(starts if plain.match_quality.mean() < MOSTLY else [])]
    for mirrored, start in starts:
        singles = None if start is None else (plain.matches, plain.match_quality)
        merged = register_merged(index, hands.of(mirrored), start, axis_rotations(), rng, singles)
        if merged is not None:
            break
    else:
        return plain
    mixtures, fit = merged.mixtures, merged.fit
    sure = mixtures.explained(TRUSTED)[mixtures.suspect_rows]
    share = _found(index.model, mixtures.reference_rows[sure])
    gained = float(mixtures.quality.sum() - plain.match_quality.sum()) / len(plain.matches)
    # Noise makes mixtures of what are single ones: they must explain no worse, and some more.
    if gained < 0.0 or (gained < GAIN and share < plain.derived_fraction + GAIN):
        return plain
    tried = plain.hypotheses_tried + merged.tried
    pairs = merged.matches, merged.quality
    return Registration(fit.scale, fit.R, fit.t, *pairs, share, True, tried, mirrored=mirrored, mixed=mixtures)


def _bend(
    index: ReferenceIndex,
    hands: Hands,
    rigid: Registration,
    verdict: Verdict | None,
    rng: np.random.Generator,
    budget: TimeBudget,
) -> Registration:
    """Step 5: the registration by a field of local maps, where that explains clearly more."""
    reference, suspect = index.model, hands.of(rigid.mirrored)
    deviations = None if verdict is None else verdict.deviations
    explained = rigid.matches
    if rigid.mixed is not None:  # what the errors of single matches say holds for these alone
        explained, deviations = np.where(rigid.mixed.explained(), 0, -1).astype(np.int32), index.floor
    todo = unexplained(reference, suspect, explained, rigid.similarity, deviations, index.floor, rng)
    if not len(todo) or not budget.allows("deformations"):
        return rigid
    bent = register_deformed(index, suspect, todo, rng, budget)
    if bent is None or bent.quality.sum() < rigid.mixtures.quality.sum() + GAIN * len(suspect):
        return rigid
    mirrored = rigid.mirrored != bent.mirrored
    rows = np.flatnonzero(bent.matches >= 0)
    part = rows[:: max(1, len(rows) // FIT_SAMPLE)]
    fit = fit_suspect(hands.of(mirrored).means[part], reference.means[bent.matches[part]]) or Similarity.identity()
    if not MIN_SCALE <= fit.scale <= MAX_SCALE:
        return rigid
    tried = rigid.hypotheses_tried + bent.tried
    share = _found(reference, bent.matches)
    pairs = bent.matches, bent.quality
    return Registration(fit.scale, fit.R, fit.t, *pairs, share, True, tried, deformed=True, mirrored=mirrored)
