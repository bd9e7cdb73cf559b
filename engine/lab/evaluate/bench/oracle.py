"""Removal with an oracle: an attacker who may ask "is the mark still there?" walks along the edge of the verdict.

HopSkipJump (Chen, Jordan and Wainwright, IEEE S&P 2020), which needs nothing but yes and no: find the edge between the
marked model and one that no longer claims, query small random moves around it, move in the mean direction of the
unclaimed ones, come back to the edge nearer to the marked model. What a question reveals of a mark of C chips is
about one part in the root of C of its direction, so a budget of questions buys little; this measures how little.

The oracle is the verification that the service runs; it reveals its verdict, and no number. Moves are drawn in all that
carries the mark, each attribute in what the mark moves it by.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from engine.flows.embed.profiles import profile as named_profile
from engine.flows.verify.search import Verification, VerifyConfig, verify_model
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.marked_scene import mark_scene
from engine.lab.evaluate.study import Row
from engine.lab.sim.adversaries.laundering import rattle, smooth
from engine.model import Float32, GaussianModel, Int64
from engine.numerics.image_metrics import psnr
from engine.raster import render
from engine.watermark.claim import Verdict

FAR = (64, 8.0)
"""Where the walk begins, beyond the edge: colours smoothed over so many, centres shaken by so many own sizes."""
HALVINGS = 8
"""Questions to find the edge on a line."""
PROBES = 24
"""Questions about random moves before each step."""
REACH = 0.05
"""Length of a random move, of the way from the marked model."""
JUDGED = 3
SIDE = 640


@dataclass(frozen=True, eq=False)
class _Way:
    """All models between the marked one (0) and one beyond the edge (1), and moves aside from that line."""

    marked: GaussianModel
    far: GaussianModel  # row for row the same Gaussians
    order: Int64  # in which every model is handed over
    units: Float32  # (N, 9) what the mark moves colour, centre and log scales by

    def model(self, place: Float32) -> GaussianModel:
        """The model whose attributes lie `place` (N, 9), in units, from the marked one's."""
        moved = self.marked
        step = place * self.units
        sh = moved.sh.copy()
        sh[:, 0] += step[:, :3]
        turned = moved.with_(sh=sh, means=moved.means + step[:, 3:6], log_scales=moved.log_scales + step[:, 6:])
        return turned.take(self.order)

    def start(self) -> Float32:
        """(N, 9) where the far model lies."""
        a, b = self.marked, self.far
        gaps = [b.sh[:, 0] - a.sh[:, 0], b.means - a.means, b.log_scales - a.log_scales]
        return np.asarray(np.concatenate(gaps, axis=1) / self.units, dtype=np.float32)


class _Oracle:
    """Yes or no, and the number of queries."""

    def __init__(self, ask: Callable[[GaussianModel], Verification], way: _Way, budget: int) -> None:
        self._ask, self._way, self._left, self.count = ask, way, budget, 0

    @property
    def spent(self) -> bool:
        """Whether no question is left."""
        return self._left <= self.count

    def claims(self, place: Float32) -> bool:
        """Whether the model there is said to be marked; yes, which helps no attacker, once the budget is spent."""
        if self.spent:
            return True
        self.count += 1
        return self._ask(self._way.model(place)).claim.verdict is Verdict.MARKED

    def edge(self, place: Float32) -> Float32:
        """The nearest place to the marked model, on the line to this unclaimed one, that was not claimed."""
        near, far = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = (near + far) / 2
            near, far = (middle, far) if self.claims(np.float32(middle) * place) else (near, middle)
        return np.asarray(np.float32(far) * place)


def measure_oracle(scene: str, questions: int, seed: int, profile: str) -> list[Row]:
    """Decibels against the original, at the edge of the verdict, after ever more of `questions`."""
    made = mark_scene(scene, named_profile(profile, landmark_views=0), seed=seed)
    rng = np.random.default_rng(seed)
    cameras = make_rig(made.original, 2 * JUDGED, SIDE, SIDE, jitter=rng.random((2 * JUDGED, 4)))[1::2]
    truth = [render(made.original, camera) for camera in cameras]
    way = _way(made.marked, made.opened.layout.displace(made.opened.layout.amplitudes), rng)

    def ask(suspect: GaussianModel) -> Verification:
        return verify_model(suspect, made.opened, VerifyConfig(route="model"))

    def row(place: Float32, questions: int) -> Row:
        suspect = way.model(place)
        paid = min(psnr(a, render(suspect, camera)) for a, camera in zip(truth, cameras, strict=True))
        z = ask(suspect).claim.z
        length = float(np.sqrt(np.square(place).mean()))
        return {"scene": made.name, "asked": questions, "psnr_db": paid, "z": z, "moved": length}

    oracle = _Oracle(ask, way, questions)
    start = way.start()
    if oracle.claims(start):
        return [row(start, 1) | {"note": "the far end claims, too"}]
    place = oracle.edge(start)
    rows = [row(place, oracle.count)]
    step = 0
    while not oracle.spent:
        step += 1
        place = _hop(oracle, place, step, rng)
        rows.append(row(place, oracle.count))
    return rows


def _way(marked: GaussianModel, moved: Float32, rng: np.random.Generator) -> _Way:
    smoothed, sigma = FAR
    far = rattle(smooth(marked, smoothed), sigma, rng)
    size = float(np.sqrt(np.square(moved).mean()))
    units = np.empty((len(marked), 9), np.float32)
    units[:, :3] = size
    units[:, 3:6] = 0.05 * np.exp(marked.log_scales.mean(axis=1))[:, None]
    units[:, 6:] = 0.02
    return _Way(marked, far, rng.permutation(len(marked)), units)


def _hop(oracle: _Oracle, place: Float32, step: int, rng: np.random.Generator) -> Float32:
    """One step of the walk: the way of fewest claims, as far as it stays unclaimed, and back to the edge."""
    length = float(np.linalg.norm(place))
    tried: list[tuple[Float32, float]] = []
    for _ in range(PROBES):
        move = rng.standard_normal(place.shape).astype(np.float32)
        move *= np.float32(REACH * length / np.linalg.norm(move))
        tried.append((move, -1.0 if oracle.claims(place + move) else 1.0))
    usual = float(np.mean([answer for _, answer in tried]))
    if abs(usual) == 1.0:  # all alike: they tell nothing but whether to go there
        usual = 0.0
    away = np.sum([np.float32(answer - usual) * move for move, answer in tried], axis=0)
    away *= np.float32(1.0 / max(float(np.linalg.norm(away)), 1e-12))
    reach = length / np.sqrt(step)
    for _ in range(HALVINGS):
        if not oracle.claims(ahead := place + np.float32(reach) * away):
            nearer = oracle.edge(ahead)
            return nearer if np.linalg.norm(nearer) < length else place
        reach /= 2
    return place
