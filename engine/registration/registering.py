"""Finding the reference in a suspect model, whatever similarity, shuffle, cut, copy or noise it went through.

The steps, cheapest first; each hands its proposal to the same judge (`judge`):

1. same order: as many Gaussians as the reference has, each looking like its namesake;
2. same frame: the reference's coordinates, or turned by a multiple of 90 degrees about the axes;
3. search: candidates that look alike, agreement among them, triples (`hypotheses`);
   with colours, exact then loose; then with more queries, for a small piece in a large foreign scene; then
   without colours, for a recoloured model;
4. merging: where Gaussians are left over, or none was found, mixtures of the reference's (`merged`);
5. deformation: where no similarity is the whole story, small patches and what grows from them
   (`deformed`).

Nothing here knows the secret of the mark: only the unmarked reference and the suspect enter. So one
registration is one hypothesis of the claim, however many alignments were weighed; their number is reported
all the same.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from engine.model import Float32, Float64, GaussianModel, Int32
from engine.numerics.similarity import quaternion_product
from engine.numerics.umeyama import Similarity
from engine.registration.candidates import sample_rows
from engine.registration.deformed import GAIN, register_deformed, unexplained
from engine.registration.hypotheses import Agreement, propose
from engine.registration.index import ReferenceIndex
from engine.registration.judge import Verdict, fit_suspect, judge, same_order
from engine.registration.merged import TRUSTED, register_merged
from engine.registration.mixtures import Mixtures

EXACT = Agreement(size=0.08, edge=0.08, angle=0.12)
"""Lossy trade formats: log scales in steps of 1/16, quaternions of 8 bits."""
LOOSE = Agreement(size=0.35, edge=0.30, angle=0.40)
"""Noise of a tenth of each attribute's standard deviation."""

FIT_SAMPLE = 50_000
"""Matched pairs from which the similarity is fitted in the end."""
CANDIDATES = 3000
"""Candidate pairs per search stage; the time of a stage grows with its square."""
SEEDS, DRAWS = 64, 64
"""Candidates around which triples are drawn, and triples per such candidate."""
MIN_SCALE, MAX_SCALE = 1e-3, 1e3
"""Scales outside are not believed."""
MIN_EVIDENCE = 12.0
"""Nats of evidence a hypothesis needs before it is judged against the whole models."""
SAMPLE, GLANCE = 4000, 400
"""Suspect Gaussians on which a hypothesis is judged and refined, and on which the turns of the axes are compared."""
LEFT_OVER = 0.002
"""Share of the suspect's Gaussians without a match from which on they are asked whether they are merged ones: a voxel
tree makes many into few."""
MIN_MATCHES = 5
"""Distinct reference Gaussians matched in that sample below which nothing is found."""


@dataclass(frozen=True)
class RegistrationConfig:
    """What the registration looks for."""

    colorless: bool = True  # search once more without colours, which costs time where nothing is found
    merged: bool = True  # look for mixtures where single Gaussians are left over
    deformed: bool = True  # look for a deformation where no similarity is the whole story


@dataclass(frozen=True, eq=False)
class Registration:
    """Where the reference is in the suspect: x_reference = scale * R @ x_suspect + t. Where it was not found, the
    similarity is the identity, and nothing is matched."""

    scale: float
    R: Float64  # (3, 3) proper rotation
    t: Float64
    matches: Int32  # (M,) reference Gaussian of each suspect Gaussian, -1 where there is none
    match_quality: Float32  # (M,) trust in each match, 0..1; 0 where there is none
    derived_fraction: float  # share of the reference's Gaussians that were found
    found: bool  # whether the suspect holds a piece of the reference
    hypotheses_tried: int  # alignments weighed, at least 1; they were chosen without the chips
    deformed: bool = False  # the matches come from a field of local maps; the similarity is the nearest single one
    mixed: Mixtures | None = None  # where suspect Gaussians are merged ones: all that was found, the matches among it

    @property
    def similarity(self) -> Similarity:
        """Scale, R and t as one value."""
        return Similarity(self.scale, self.R, self.t)

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
) -> Registration:
    """Find the reference, or pieces of it, in a suspect model.

    The reference is the unmarked one; an index serves many suspects. The same seed, of the samples and triples drawn,
    gives the same answer. `found` is False if the suspect holds no recognizable piece; that is an answer, not an error.
    """
    index = reference if isinstance(reference, ReferenceIndex) else ReferenceIndex(reference)
    n, m = len(index.model), len(suspect)
    if n < 3 or m < 3:
        return _nothing(m, 1)
    rng = np.random.default_rng(seed)
    tried = 0
    if n == m:
        tried += 1
        verdict = same_order(index.model, suspect, index.floor, rng)
        if verdict is not None:
            return _answer(index, suspect, verdict, tried)
    verdict, count = _same_frame(index, suspect, rng)
    tried += count
    if verdict is None:
        verdict, count = _search(index, suspect, rng, config)
        tried += count
    answer = _nothing(m, tried) if verdict is None else _answer(index, suspect, verdict, tried)
    if config.merged and (answer.matches < 0).mean() > LEFT_OVER:
        answer = _unmerge(index, suspect, answer, rng)
    return _bend(index, suspect, answer, verdict, rng) if config.deformed else answer


def _nothing(m: int, tried: int) -> Registration:
    unmatched = np.full(m, -1, np.int32), np.zeros(m, np.float32)
    return Registration(1.0, np.eye(3), np.zeros(3), *unmatched, 0.0, False, max(1, tried))


def _answer(index: ReferenceIndex, suspect: GaussianModel, verdict: Verdict, tried: int) -> Registration:
    """The registration that follows from a verdict: every suspect Gaussian is matched."""
    if verdict.matcher is None:
        assert verdict.order_quality is not None
        quality = verdict.order_quality
        matches = np.where(quality > 0, np.arange(len(suspect)), -1).astype(np.int32)
    else:
        neighbours = verdict.matcher.match(suspect, verdict.fit, verdict.deviations)
        quality = verdict.matcher.quality(neighbours)
        matches = np.where(quality > 0, neighbours.index, -1).astype(np.int32)
    rows = np.flatnonzero(matches >= 0)
    fit = verdict.fit
    if verdict.matcher is not None and len(rows) > 3:
        part = rows[:: max(1, len(rows) // FIT_SAMPLE)]
        fit = fit_suspect(suspect.means[part], index.model.means[matches[part]], start=fit) or fit
    return Registration(fit.scale, fit.R, fit.t, matches, quality, _found(index.model, matches), True, tried)


def _found(reference: GaussianModel, matches: Int32) -> float:
    """Share of the reference's Gaussians that are among the matches."""
    seen = np.zeros(len(reference), np.bool_)
    seen[matches[matches >= 0]] = True
    return float(seen.mean())


def _unmerge(
    index: ReferenceIndex, suspect: GaussianModel, plain: Registration, rng: np.random.Generator
) -> Registration:
    """Step 4: the registration by mixtures, where they explain clearly more than plain matches."""
    start = plain.similarity if plain.found else None
    merged = register_merged(index, suspect, start, _axis_rotations(), rng)
    if merged is None:
        return plain
    mixtures, fit = merged.mixtures, merged.fit
    sure = mixtures.explained(TRUSTED)[mixtures.suspect_rows]
    share = _found(index.model, mixtures.reference_rows[sure])
    gained = float(mixtures.quality.sum() - plain.match_quality.sum()) / len(suspect)
    if gained < GAIN and share < plain.derived_fraction + GAIN:
        return plain
    tried = plain.hypotheses_tried + merged.tried
    pairs = merged.matches, merged.quality
    return Registration(fit.scale, fit.R, fit.t, *pairs, share, True, tried, mixed=mixtures)


def _bend(
    index: ReferenceIndex,
    suspect: GaussianModel,
    rigid: Registration,
    verdict: Verdict | None,
    rng: np.random.Generator,
) -> Registration:
    """Step 5: the registration by a field of local maps, where that explains clearly more."""
    reference = index.model
    deviations = None if verdict is None else verdict.deviations
    explained = rigid.matches
    if rigid.mixed is not None:  # what the errors of single matches say holds for these alone
        explained, deviations = np.where(rigid.mixed.explained(), 0, -1).astype(np.int32), index.floor
    todo = unexplained(reference, suspect, explained, rigid.similarity, deviations, index.floor, rng)
    if not len(todo):
        return rigid
    bent = register_deformed(index, suspect, todo, rng)
    if bent is None or bent.quality.sum() < rigid.mixtures.quality.sum() + GAIN * len(suspect):
        return rigid
    rows = np.flatnonzero(bent.matches >= 0)
    part = rows[:: max(1, len(rows) // FIT_SAMPLE)]
    fit = fit_suspect(suspect.means[part], reference.means[bent.matches[part]]) or rigid.similarity
    if not MIN_SCALE <= fit.scale <= MAX_SCALE:
        return rigid
    tried = rigid.hypotheses_tried + bent.tried
    share = _found(reference, bent.matches)
    return Registration(fit.scale, fit.R, fit.t, bent.matches, bent.quality, share, True, tried, deformed=True)


def _axis_rotations() -> list[Float64]:
    """The 24 proper rotations that map axes to axes, the identity first: what tools do to 'up'."""
    turns = [np.round(r) for r in Rotation.create_group("O").as_matrix()]
    return sorted(turns, key=lambda r: (-float(np.trace(r)), r.tolist()))


def _same_frame(index: ReferenceIndex, suspect: GaussianModel, rng: np.random.Generator) -> tuple[Verdict | None, int]:
    """Step 2: no scale, no translation, at most a turn of the axes."""
    rows = sample_rows(len(suspect), GLANCE, rng)
    part = suspect.take(rows)
    turns = _axis_rotations()
    hits = []
    for R in turns:
        matched = index.matcher.match(part, Similarity(1.0, R, np.zeros(3)))
        hits.append(int((matched.index >= 0).sum()))
        if len(hits) == 1 and hits[0] > 0.5 * len(rows):
            break
    best = int(np.argmax(hits))
    if hits[best] < max(MIN_MATCHES, 0.01 * len(rows)):
        return None, len(hits)
    fit = Similarity(1.0, turns[best], np.zeros(3))
    return _judge(index, suspect, fit, None, rng), len(hits)


def _search(
    index: ReferenceIndex, suspect: GaussianModel, rng: np.random.Generator, config: RegistrationConfig
) -> tuple[Verdict | None, int]:
    """Step 3: candidates, agreement, triples."""
    degree = min(index.model.sh_degree, suspect.sh_degree)
    tried = 0
    stages = [(True, False), (True, True)] + ([(False, False)] if config.colorless else [])
    for colors, deep in stages:
        queries = (10 if deep else 2) * CANDIDATES
        if deep and len(suspect) <= queries // 5:
            continue  # they were all asked before
        looks = index.features(degree, colors=colors)
        pairs = looks.candidates(suspect, CANDIDATES, rng, queries=queries, deep=deep)
        votes = np.exp(pairs.size)
        pairs = pairs.take((votes >= MIN_SCALE / 2) & (votes <= MAX_SCALE * 2))
        conjugate = suspect.quats[pairs.suspect] * np.array([1, -1, -1, -1])
        turn = quaternion_product(index.model.quats[pairs.reference], conjugate)
        for level in (EXACT, LOOSE):
            for agreement in (level, Agreement(level.size, level.edge, np.inf)):
                scene, seed = (index.extent, index.chance), int(rng.integers(2**31))
                hypotheses, count = propose(pairs, turn, agreement, *scene, seeds=SEEDS, draws=DRAWS, seed=seed)
                tried += count
                for h in hypotheses[:2]:
                    if h.evidence < MIN_EVIDENCE:
                        break
                    if not MIN_SCALE <= h.fit.scale <= MAX_SCALE:
                        continue
                    inliers = (pairs.reference[h.inliers], pairs.suspect[h.inliers])
                    verdict = _judge(index, suspect, h.fit, inliers, rng)
                    if verdict is not None:
                        return verdict, tried
    return None, tried


def _judge(
    index: ReferenceIndex,
    suspect: GaussianModel,
    fit: Similarity,
    inliers: tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]] | None,
    rng: np.random.Generator,
) -> Verdict | None:
    rows = sample_rows(len(suspect), SAMPLE, rng)
    return judge(index.model, suspect, fit, inliers, rows, index.matcher, rng, min_matches=MIN_MATCHES)
