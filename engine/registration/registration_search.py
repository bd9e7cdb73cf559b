"""Finding the reference in a suspect model, whatever similarity, mirror, shuffle, cut, copy or noise it went through.

The steps, cheapest first; `agreement.confirm_similarity` tests the hypotheses of each:

1. same order: as many Gaussians as the reference has, each looking like the one in its row;
2. same frame: the reference's coordinates, or turned by a multiple of 90 degrees about the axes;
3. search: candidates that look alike, agreement among them, triples (`hypotheses`);
   with colours, exact then loose; then with more queries, for a small piece in a large foreign scene; then
   without colours, for a recoloured model;
4. merging: where Gaussians are left over, or none was found, mixtures of the reference's (`mixtures`);
5. deformation: where no similarity is the whole story, small patches and what grows from them
   (`deformed`).

Steps 1 to 3 (`similarity_search`) search the suspect as it came and its mirror image; the maps of step 4 may mirror.

Nothing here knows the secret of the mark: only the unmarked reference and the suspect enter. So one
registration is one hypothesis of the claim, however many alignments were weighed; their number is reported,
too.
"""

from dataclasses import dataclass, replace

import numpy as np

from engine.model import Bool, Float32, Float64, GaussianModel, Int32
from engine.numerics.similarity import mirror_model, transform_model
from engine.numerics.time_budget import UNLIMITED, TimeBudget
from engine.numerics.umeyama import Similarity, fit_noisy_source
from engine.registration.agreement import Verdict
from engine.registration.config import CONFIG
from engine.registration.deformed import register_deformed, unexplained
from engine.registration.looks_index import ReferenceIndex
from engine.registration.match_classes import by_size
from engine.registration.mixtures import Mixtures, register_merged
from engine.registration.similarity_search import BOTH, Hands, axis_rotations, in_order, locate
from engine.registration.visibility import drawn


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
    # rows, which do not change by mirroring.
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
    rng, hands = np.random.default_rng(seed), Hands(suspect)
    if seen.all() or len(index.model) < 3:
        return _register(index, hands, rng, config, budget)[0]
    as_many = len(index.model) == len(suspect) >= 3
    known = in_order(index, hands, BOTH, rng) if as_many else None
    if known is not None:  # without some rows the order would be lost
        return _without_undrawn(index, seen, _register(index, hands, rng, config, budget, known)[0])
    rng = np.random.default_rng(seed)
    found, verdict = _register(index, Hands(suspect.take(seen)), rng, config, budget)
    found = replace(found, hypotheses_tried=found.hypotheses_tried + as_many)
    return _with_undrawn(index, suspect, seen, found, verdict)


def _without_undrawn(index: ReferenceIndex, seen: Bool, whole: Registration) -> Registration:
    """What was found in all rows of a suspect, but that undrawn ones (M,) stand for no Gaussian that is plainly
    drawn."""
    matches, quality = whole.matches.copy(), whole.match_quality.copy()
    wrong = ~seen & ((matches < 0) | index.plain[matches])
    matches[wrong], quality[wrong] = -1, 0.0
    mixed = whole.mixed
    held = matches
    if mixed is not None:
        mixed = replace(mixed, quality=np.where(wrong, np.float32(0.0), mixed.quality))
        held = mixed.reference_rows[mixed.explained(CONFIG.merging.trusted)[mixed.suspect_rows]]
    whole = replace(whole, derived_fraction=_found(index.model, held), undrawn=int(wrong.sum()))
    return replace(whole, matches=matches, match_quality=quality, mixed=mixed)


def _with_undrawn(
    index: ReferenceIndex, suspect: GaussianModel, seen: Bool, found: Registration, verdict: Verdict | None
) -> Registration:
    """What was found in the rows that are drawn, as matches of all rows of the suspect. Of the others only those
    count that are Gaussians which are hardly seen in the reference either: an original may have such."""
    matches, quality = np.full(len(suspect), -1, np.int32), np.zeros(len(suspect), np.float32)
    rows, others = np.flatnonzero(seen), np.flatnonzero(~seen)
    matches[rows], quality[rows] = found.matches, found.match_quality
    if verdict is not None and not index.plain.all():
        rest = Hands(suspect.take(others)).bare(verdict.mirrored)
        matcher = verdict.matcher or index.matcher
        near, trust = matcher.pair(rest, verdict.fit, verdict.deviations)
        own = (near >= 0) & ~index.plain[near]
        matches[others[own]], quality[others[own]] = near[own], trust[own]
        others = others[~own]
    mixed = found.mixed
    if mixed is not None:
        trust = np.zeros(len(suspect), np.float32)
        trust[rows] = mixed.quality
        mixed = replace(mixed, suspect_rows=rows[mixed.suspect_rows].astype(np.int32), quality=trust)
    share = found.derived_fraction if mixed is not None else _found(index.model, matches)
    found = replace(found, derived_fraction=share, undrawn=len(others))
    return replace(found, matches=matches, match_quality=quality, mixed=mixed)


def _register(
    index: ReferenceIndex,
    hands: Hands,
    rng: np.random.Generator,
    config: RegistrationConfig,
    budget: TimeBudget,
    known: Verdict | None = None,
) -> tuple[Registration, Verdict | None]:
    """The registration, and by what its Gaussians were matched, where each is one of the reference's; `known`: what
    `locate` would find first."""
    n, m = len(index.model), len(hands.suspect)
    if n < 3 or m < 3:
        return _nothing(m, 1), None
    verdict, tried = known, 1
    if known is None:
        verdict, tried = locate(index, hands, rng, colorless=config.colorless, budget=budget)
    either: list[tuple[Registration, Verdict | None]] = [(_nothing(m, tried), None)]
    if verdict is not None:
        either = [_answer(index, hands, verdict, tried, rng)]
        others, weighed = _other_hand(index, hands, either[0][0], rng, budget)
        either += others
        tried += weighed
    if config.merged:
        either = [(_unmerge(index, hands, rigid, rng, budget), found) for rigid, found in either]
    # A thing as symmetric as a pot lies in its mirror image, too: which explains more shows when all is explained.
    rigid, verdict = max(either, key=lambda one: float(one[0].mixtures.quality.sum()))
    rigid = replace(rigid, hypotheses_tried=max(tried, *(one.hypotheses_tried for one, _ in either)))
    answer = _bend(index, hands, rigid, verdict, rng, budget) if config.deformed else rigid
    return answer, None if answer.deformed or answer.mixed is not None else verdict


def _nothing(m: int, tried: int) -> Registration:
    unmatched = np.full(m, -1, np.int32), np.zeros(m, np.float32)
    return Registration(1.0, np.eye(3), np.zeros(3), *unmatched, 0.0, False, max(1, tried))


def _answer(
    index: ReferenceIndex, hands: Hands, verdict: Verdict, tried: int, rng: np.random.Generator
) -> tuple[Registration, Verdict]:
    """The registration that follows from a verdict: every suspect Gaussian is matched; and by which matcher."""
    suspect = hands.bare(verdict.mirrored)
    matches, quality = verdict.match(suspect)
    if quality.mean() < CONFIG.explained:
        in_order = verdict.order_quality is not None
        sized = by_size(index.model, suspect, verdict.fit, verdict.deviations, index.floor, rng, in_order=in_order)
        grown = verdict if sized is None else replace(verdict, matcher=sized)
        again = (matches, quality) if sized is None else grown.match(suspect)
        if again[1].sum() > quality.sum():
            (matches, quality), verdict = again, grown
    rows = np.flatnonzero(matches >= 0)
    fit = verdict.fit
    if verdict.order_quality is None and len(rows) > 3:
        part = rows[:: max(1, len(rows) // CONFIG.fit_sample)]
        fit = fit_noisy_source(suspect.means[part], index.model.means[matches[part]], start=fit) or fit
    share = _found(index.model, matches)
    found = matches, quality, share, True, tried
    return Registration(fit.scale, fit.R, fit.t, *found, mirrored=verdict.mirrored), verdict


def _other_hand(
    index: ReferenceIndex, hands: Hands, rigid: Registration, rng: np.random.Generator, budget: TimeBudget
) -> tuple[list[tuple[Registration, Verdict | None]], int]:
    """The registration with the other hand, if there is one, where this one leaves much over: a small piece left as it
    was hides no mirror. And how many alignments were weighed."""
    left = np.flatnonzero(rigid.matches < 0)
    least = max(CONFIG.least_rest, (1.0 - CONFIG.mostly) * len(rigid.matches))
    if len(left) < least or not budget.allows("the other hand"):
        return [], 0
    rest = Hands(hands.suspect.take(left))
    other, count = locate(index, rest, rng, hands_searched=(not rigid.mirrored,), colorless=False, budget=budget)
    if other is None or other.order_quality is not None:
        return [], count
    return [_answer(index, hands, other, rigid.hypotheses_tried + count, rng)], count


def _found(reference: GaussianModel, matches: Int32) -> float:
    """Share of the reference's Gaussians that are among the matches."""
    seen = np.zeros(len(reference), np.bool_)
    seen[matches[matches >= 0]] = True
    return float(seen.mean())


def _unmerge(
    index: ReferenceIndex, hands: Hands, plain: Registration, rng: np.random.Generator, budget: TimeBudget
) -> Registration:
    """Step 4: the registration by mixtures, where they explain clearly more than plain matches."""
    if (plain.matches < 0).mean() <= CONFIG.left_over or not budget.allows("merged Gaussians"):
        return plain
    starts: list[tuple[bool, Similarity | None]] = [(False, None), (True, None)]
    if plain.found:
        # Where few are matched well, the place may be wrong itself.
        starts = [(plain.mirrored, plain.similarity), *(starts if plain.match_quality.mean() < CONFIG.mostly else [])]
    for mirrored, start in starts:
        singles = None if start is None else (plain.matches, plain.match_quality)
        merged = register_merged(index, hands.of(mirrored), start, axis_rotations(), rng, singles)
        if merged is not None:
            break
    else:
        return plain
    mixtures, fit = merged.mixtures, merged.fit
    sure = mixtures.explained(CONFIG.merging.trusted)[mixtures.suspect_rows]
    share = _found(index.model, mixtures.reference_rows[sure])
    gained = float(mixtures.quality.sum() - plain.match_quality.sum()) / len(plain.matches)
    # Noise makes mixtures of what are single ones: they must explain no worse, and some more.
    if gained < 0.0 or (gained < CONFIG.deformation.gain and share < plain.derived_fraction + CONFIG.deformation.gain):
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
    if bent is None or bent.quality.sum() < rigid.mixtures.quality.sum() + CONFIG.deformation.gain * len(suspect):
        return rigid
    mirrored = rigid.mirrored != bent.mirrored
    rows = np.flatnonzero(bent.matches >= 0)
    part = rows[:: max(1, len(rows) // CONFIG.fit_sample)]
    fit = fit_noisy_source(hands.of(mirrored).means[part], reference.means[bent.matches[part]]) or Similarity.identity()
    if not CONFIG.similarity.min_scale <= fit.scale <= CONFIG.similarity.max_scale:
        return rigid
    tried = rigid.hypotheses_tried + bent.tried
    share = _found(reference, bent.matches)
    pairs = bent.matches, bent.quality
    return Registration(fit.scale, fit.R, fit.t, *pairs, share, True, tried, deformed=True, mirrored=mirrored)
