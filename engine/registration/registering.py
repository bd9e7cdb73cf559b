"""Finding the reference in a suspect model, whatever similarity, shuffle, cut, copy or noise it went through.

The steps, cheapest first; each hands its proposal to the same judge (`judge`):

1. same order: as many Gaussians as the reference has, each looking like its namesake;
2. same frame: the reference's coordinates, or turned by a multiple of 90 degrees about the axes;
3. search: candidates that look alike, agreement among them, triples (`hypotheses`);
   with colours, exact then loose; then with more queries, for a small piece in a large foreign scene; then
   without colours, for a recoloured model;
4. deformation: where no similarity is the whole story, small patches and what grows from them
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

EXACT = Agreement(size=0.08, edge=0.08, angle=0.12)
"""Lossy trade formats: log scales in steps of 1/16, quaternions of 8 bits."""
LOOSE = Agreement(size=0.35, edge=0.30, angle=0.40)
"""Noise of a tenth of each attribute's standard deviation."""

FIT_SAMPLE = 50_000
"""Matched pairs from which the similarity is fitted in the end."""


@dataclass(frozen=True)
class RegistrationConfig:
    """Knobs of the registration.

    Parameters
    ----------
    candidates : int
        Candidate pairs per search stage; the time of a stage grows with its square.
    seeds, draws : int
        Candidates around which triples are drawn, and triples per such candidate.
    min_scale, max_scale : float
        Scales outside are not believed.
    min_evidence : float
        Nats of evidence a hypothesis needs before it is judged against the whole models.
    sample : int
        Suspect Gaussians on which a hypothesis is judged and refined.
    min_matches : int
        Distinct reference Gaussians matched in that sample below which nothing is found.
    colorless : bool
        Whether to search once more without colours, which costs time where nothing is found.
    deformed : bool
        Whether to look for a deformation where no similarity is the whole story.
    """

    candidates: int = 3000
    seeds: int = 64
    draws: int = 64
    min_scale: float = 1e-3
    max_scale: float = 1e3
    min_evidence: float = 12.0
    sample: int = 4000
    min_matches: int = 5
    colorless: bool = True
    deformed: bool = True


@dataclass(frozen=True, eq=False)
class Registration:
    """Where the reference is in the suspect: x_reference = scale * R @ x_suspect + t.

    Parameters
    ----------
    R : (3, 3) float64
        Proper rotation.
    t : (3,) float64
    matches : (M,) int32
        Reference Gaussian of each suspect Gaussian, -1 where there is none.
    match_quality : (M,) float32
        Trust in each match, 0..1; 0 where there is none.
    derived_fraction : float
        Share of the reference's Gaussians that were found.
    suspect_fraction : float
        Share of the suspect's Gaussians that the reference explains.
    found : bool
        Whether the suspect holds a piece of the reference. If not, the similarity is the identity, and
        nothing is matched.
    identity_order : bool
        Whether Gaussian i of the suspect is Gaussian i of the reference.
    hypotheses_tried : int
        Alignments weighed, at least 1. They were chosen without the chips.
    deformed : bool
        Whether the matches come from a field of local maps; the similarity is then the nearest single one.
    """

    scale: float
    R: Float64
    t: Float64
    matches: Int32
    match_quality: Float32
    derived_fraction: float
    suspect_fraction: float
    found: bool
    identity_order: bool
    hypotheses_tried: int
    deformed: bool = False

    @property
    def similarity(self) -> Similarity:
        """Scale, R and t as one value."""
        return Similarity(self.scale, self.R, self.t)


def register(
    reference: GaussianModel | ReferenceIndex,
    suspect: GaussianModel,
    *,
    seed: int = 0,
    config: RegistrationConfig = RegistrationConfig(),
) -> Registration:
    """Find the reference, or pieces of it, in a suspect model.

    Parameters
    ----------
    reference : GaussianModel or ReferenceIndex
        The unmarked reference.
    seed : int
        Of the samples and triples drawn; the same seed gives the same answer.

    Returns
    -------
    Registration
        With `found` False if the suspect holds no recognizable piece; that is an answer, not an error.
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
            return _answer(index, suspect, verdict, tried, ordered=True)
    verdict, count = _same_frame(index, suspect, rng, config)
    tried += count
    if verdict is None:
        verdict, count = _search(index, suspect, rng, config)
        tried += count
    rigid = _nothing(m, tried) if verdict is None else _answer(index, suspect, verdict, tried, ordered=False)
    return _bend(index, suspect, rigid, verdict, rng, config) if config.deformed else rigid


def _nothing(m: int, tried: int) -> Registration:
    return Registration(
        1.0,
        np.eye(3),
        np.zeros(3),
        np.full(m, -1, np.int32),
        np.zeros(m, np.float32),
        0.0,
        0.0,
        False,
        False,
        max(1, tried),
    )


def _answer(
    index: ReferenceIndex, suspect: GaussianModel, verdict: Verdict, tried: int, *, ordered: bool
) -> Registration:
    """The registration that follows from a verdict: every suspect Gaussian is matched."""
    n, m = len(index.model), len(suspect)
    if verdict.matcher is None:
        assert verdict.order_quality is not None
        quality = verdict.order_quality
        matches = np.where(quality > 0, np.arange(m), -1).astype(np.int32)
    else:
        neighbours = verdict.matcher.match(suspect, verdict.fit, verdict.deviations)
        quality = verdict.matcher.quality(neighbours)
        matches = np.where(quality > 0, neighbours.index, -1).astype(np.int32)
    rows = np.flatnonzero(matches >= 0)
    fit = verdict.fit
    if verdict.matcher is not None and len(rows) > 3:
        part = rows[:: max(1, len(rows) // FIT_SAMPLE)]
        fit = fit_suspect(suspect.means[part], index.model.means[matches[part]], start=fit) or fit
    seen = np.zeros(n, np.bool_)
    seen[matches[rows]] = True
    return Registration(
        fit.scale, fit.R, fit.t, matches, quality, float(seen.mean()), len(rows) / m, True, ordered, tried
    )


def _bend(
    index: ReferenceIndex,
    suspect: GaussianModel,
    rigid: Registration,
    verdict: Verdict | None,
    rng: np.random.Generator,
    config: RegistrationConfig,
) -> Registration:
    """Step 4: the registration by a field of local maps, where that explains clearly more."""
    reference = index.model
    deviations = None if verdict is None else verdict.deviations
    todo = unexplained(reference, suspect, rigid.matches, rigid.similarity, deviations, index.floor, rng)
    if not len(todo):
        return rigid
    bent = register_deformed(index, suspect, todo, rng)
    if bent is None or bent.quality.sum() < rigid.match_quality.sum() + GAIN * len(suspect):
        return rigid
    rows = np.flatnonzero(bent.matches >= 0)
    part = rows[:: max(1, len(rows) // FIT_SAMPLE)]
    fit = fit_suspect(suspect.means[part], reference.means[bent.matches[part]]) or rigid.similarity
    if not config.min_scale <= fit.scale <= config.max_scale:
        return rigid
    seen = np.zeros(len(reference), np.bool_)
    seen[bent.matches[rows]] = True
    return Registration(
        fit.scale,
        fit.R,
        fit.t,
        bent.matches,
        bent.quality,
        float(seen.mean()),
        len(rows) / len(suspect),
        True,
        False,
        rigid.hypotheses_tried + bent.tried,
        deformed=True,
    )


def _axis_rotations() -> list[Float64]:
    """The 24 proper rotations that map axes to axes, the identity first: what tools do to 'up'."""
    turns = [np.round(r) for r in Rotation.create_group("O").as_matrix()]
    return sorted(turns, key=lambda r: (-float(np.trace(r)), r.tolist()))


def _same_frame(
    index: ReferenceIndex, suspect: GaussianModel, rng: np.random.Generator, config: RegistrationConfig
) -> tuple[Verdict | None, int]:
    """Step 2: no scale, no translation, at most a turn of the axes."""
    rows = sample_rows(len(suspect), 400, rng)
    part = suspect.take(rows)
    turns = _axis_rotations()
    hits = []
    for R in turns:
        matched = index.matcher.match(part, Similarity(1.0, R, np.zeros(3)))
        hits.append(int((matched.index >= 0).sum()))
        if len(hits) == 1 and hits[0] > 0.5 * len(rows):
            break
    best = int(np.argmax(hits))
    if hits[best] < max(config.min_matches, 0.01 * len(rows)):
        return None, len(hits)
    fit = Similarity(1.0, turns[best], np.zeros(3))
    return _judge(index, suspect, fit, None, rng, config), len(hits)


def _search(
    index: ReferenceIndex, suspect: GaussianModel, rng: np.random.Generator, config: RegistrationConfig
) -> tuple[Verdict | None, int]:
    """Step 3: candidates, agreement, triples."""
    degree = min(index.model.sh_degree, suspect.sh_degree)
    tried = 0
    stages = [(True, False), (True, True)] + ([(False, False)] if config.colorless else [])
    for colors, deep in stages:
        queries = (10 if deep else 2) * config.candidates
        if deep and len(suspect) <= queries // 5:
            continue  # they were all asked before
        looks = index.features(degree, colors=colors)
        pairs = looks.candidates(suspect, config.candidates, rng, queries=queries, deep=deep)
        votes = np.exp(pairs.size)
        pairs = pairs.take((votes >= config.min_scale / 2) & (votes <= config.max_scale * 2))
        conjugate = suspect.quats[pairs.suspect] * np.array([1, -1, -1, -1])
        turn = quaternion_product(index.model.quats[pairs.reference], conjugate)
        for level in (EXACT, LOOSE):
            for agreement in (level, Agreement(level.size, level.edge, np.inf)):
                hypotheses, count = propose(
                    pairs,
                    turn,
                    agreement,
                    index.extent,
                    index.chance,
                    seeds=config.seeds,
                    draws=config.draws,
                    seed=int(rng.integers(2**31)),
                )
                tried += count
                for h in hypotheses[:2]:
                    if h.evidence < config.min_evidence:
                        break
                    if not config.min_scale <= h.fit.scale <= config.max_scale:
                        continue
                    inliers = (pairs.reference[h.inliers], pairs.suspect[h.inliers])
                    verdict = _judge(index, suspect, h.fit, inliers, rng, config)
                    if verdict is not None:
                        return verdict, tried
    return None, tried


def _judge(
    index: ReferenceIndex,
    suspect: GaussianModel,
    fit: Similarity,
    inliers: tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]] | None,
    rng: np.random.Generator,
    config: RegistrationConfig,
) -> Verdict | None:
    rows = sample_rows(len(suspect), config.sample, rng)
    return judge(index.model, suspect, fit, inliers, rows, index.matcher, rng, min_matches=config.min_matches)
