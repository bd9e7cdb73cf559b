"""All rows of one sweep as curves over its strengths, and where they break."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from engine.evaluate.intervals import bootstrap, share_interval
from engine.evaluate.stability.breaking import Break, breaking_point, strength_at
from engine.evaluate.study import Row
from engine.model import Float64
from engine.sim.attack import Strength
from engine.sim.cost import CHEAP_DB

__all__ = ["LEAST_BITS", "Swept", "failing_first", "sum_up"]

LEAST_BITS = 0.99
HELD_COVERAGE = 0.1
"""An attacker who keeps less than this share of what is to be seen has lost the model, too (DESIGN 12: 10 %)."""


@dataclass(frozen=True, eq=False)
class Swept:
    """One attack in one reading and direction, all scenes and trials together.

    Parameters
    ----------
    name : str
        Attack, direction and reading.
    kind : {"model", "image"}
    strengths : tuple
        From harmless to ruinous.
    bits, paper, z, claimed : (T, S) float64
        For each trial and strength.
    bits_baselines : dict of str to (S,) float64
        Mean over the scenes; NaN where a baseline was not read.
    psnr : (S,) float64
        What is left of the look, dB, mean over the scenes; NaN where nothing says so.
    coverage : (S,) float64
        Share of what is to be seen that an attacked model still covers; NaN for pictures.
    by_looking : dict of float to float
        z of the renders at the first strength whose Gaussians gave no claim, least of the scenes.
    """

    name: str
    kind: str
    strengths: tuple[Strength, ...]
    bits: Float64
    paper: Float64
    z: Float64
    claimed: Float64
    bits_baselines: dict[str, Float64]
    psnr: Float64
    coverage: Float64
    z_threshold: float
    by_looking: dict[Strength, float]

    @property
    def ordered(self) -> bool:
        """Whether strengths are numbers, so that there is something between two of them."""
        return not any(isinstance(value, str) for value in self.strengths)

    @property
    def bits_break(self) -> Break:
        """Where the mean of bits falls below 99 %."""
        return breaking_point(self.bits, LEAST_BITS)

    @property
    def claim_break(self) -> Break:
        """Where the mean z falls below the threshold of a claim at 1e-9."""
        return breaking_point(self.z, self.z_threshold)

    @property
    def is_cheap(self) -> bool:
        """Whether the claim goes while the attacker keeps the look of a good part of the model."""
        broken = self.claim_break
        if not broken.lost:
            return False
        look, left = self.psnr_at(broken.step), self.coverage_at(broken.step)
        return (look is None or look >= CHEAP_DB) and (left is None or left >= HELD_COVERAGE)

    def psnr_at(self, step: float) -> float | None:
        """dB between two strengths; None where no look was judged."""
        if not np.isfinite(self.psnr).any():
            return None
        known = np.isfinite(self.psnr)
        at = np.arange(len(self.psnr))
        return float(np.interp(min(step, len(at) - 1), at[known], self.psnr[known]))

    def coverage_at(self, step: float) -> float | None:
        """Share between two strengths; None where it was not measured."""
        if not np.isfinite(self.coverage).all():
            return None
        return float(np.interp(step, np.arange(len(self.coverage)), self.coverage))

    def strength_of(self, step: float) -> float | str | None:
        """The strength at a step; a name where strengths are names."""
        if not math.isfinite(step):
            return None
        if not self.ordered:
            return str(self.strengths[min(math.ceil(step), len(self.strengths) - 1)])
        return strength_at(self.strengths, step)

    def claims_interval(self, step: int) -> tuple[float, float]:
        """Exact 95 % interval of the share of claims."""
        column = self.claimed[:, step]
        return share_interval(int(column.sum()), len(column))

    def z_interval(self, step: int) -> tuple[float, float]:
        """Bootstrap 95 % interval of the mean z."""
        return bootstrap(list(self.z[:, step]))


def sum_up(rows: Sequence[Row]) -> list[Swept]:
    """Curves of all sweeps; a trial that could not be run at some strength is left out."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if row["what"] == "sweep" and "refused" not in row:
            name = row["cell"].split("-", 1)[1]
            groups.setdefault((name, row["kind"]), []).append(row)
    return [_swept(name, kind, own) for (name, kind), own in groups.items()]


def _swept(name: str, kind: str, rows: Sequence[Row]) -> Swept:
    steps = sorted({row["step"] for row in rows})
    strengths = tuple(next(row["strength"] for row in rows if row["step"] == step) for step in steps)
    trials: dict[tuple[str, int], dict[int, Row]] = {}
    for row in rows:
        trials.setdefault((row["cell"], row["trial"]), {})[row["step"]] = row
    whole = [trial for trial in trials.values() if len(trial) == len(steps)]

    def table(field: str) -> Float64:
        return np.array([[float(trial[step][field]) for step in steps] for trial in whole])

    def over_steps(field: str) -> Float64:
        return np.array([_mean(row.get(field) for row in rows if row["step"] == step) for step in steps])

    baselines = {
        key.removeprefix("bits_") for row in rows for key in row if key.startswith("bits_") and key != "bits_paper"
    }
    looked: dict[Strength, float] = {}
    for row in rows:
        if "z_by_looking" in row:
            looked[row["strength"]] = min(looked.get(row["strength"], math.inf), row["z_by_looking"])
    return Swept(
        name,
        kind,
        strengths,
        table("bits"),
        table("bits_paper"),
        table("z"),
        table("claimed"),
        {name: over_steps(f"bits_{name}") for name in sorted(baselines)},
        over_steps("psnr"),
        over_steps("coverage"),
        max(row["z_threshold"] for row in rows),
        looked,
    )


def _mean(values: Iterable[float | None]) -> float:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else math.nan


def failing_first(swept: Sequence[Swept]) -> list[Swept]:
    """Those that take the claim at the best look first; then those that take bits; then those that take nothing."""

    def rank(one: Swept) -> tuple[int, float, float]:
        claim, bits = one.claim_break, one.bits_break
        broken = claim if claim.lost else bits
        look = one.psnr_at(broken.step) if broken.lost else None
        return (
            0 if claim.lost else 1 if bits.lost else 2,
            -(look if look is not None else 0.0),
            float(one.z[:, -1].mean()),
        )

    return sorted(swept, key=rank)
