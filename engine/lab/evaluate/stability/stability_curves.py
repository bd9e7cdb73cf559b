"""All rows of one sweep as curves over its strengths: where they break, interpolated, with intervals; and drawn."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from engine.lab.evaluate.figures import SEQUENTIAL, Figure, figure
from engine.lab.evaluate.intervals import bootstrap, share_interval
from engine.lab.evaluate.study import Row
from engine.lab.evaluate.summary import grouped, picked
from engine.lab.sim.attack import Strength
from engine.lab.sim.attack_cost import CHEAP_DB
from engine.model import Float64

__all__ = ["Break", "Swept", "breaking_point", "draw_map", "failing_first", "first_below", "strength_at", "sum_up"]

GEOMETRIC = 8.0
"""Factor between the ends of a wide range."""
LEAST_BITS = 0.99
HELD_COVERAGE = 0.1
"""An attacker who keeps less than this share of what is to be seen has lost the model, too (DESIGN 12: 10 %)."""


COLUMNS = 25
"""Of a map: every sweep is stretched to the same length, harmless to ruinous."""


@dataclass(frozen=True)
class Break:
    """Where the level is lost, in steps of the sweep (0 is its first strength); infinite where it never is.

    `low` and `high` are the 95 % interval over resampled trials.
    """

    step: float
    low: float
    high: float

    @property
    def lost(self) -> bool:
        """Whether the sweep got that far."""
        return math.isfinite(self.step)


def first_below(curve: Sequence[float] | Float64, level: float) -> float:
    """Step at which a piecewise linear curve first falls below a level; inf where it never does."""
    values = np.asarray(curve, dtype=np.float64)
    below = np.flatnonzero(values < level)
    if not len(below):
        return math.inf
    k = int(below[0])
    if k == 0:
        return 0.0
    return float(k - 1 + (values[k - 1] - level) / (values[k - 1] - values[k]))


def breaking_point(curves: Float64, level: float, *, draws: int = 1_000, seed: int = 0) -> Break:
    """Where the mean of several trials' curves (trials, steps) falls below a level; `draws` resamples of the trials."""
    picks = np.random.default_rng(seed).integers(len(curves), size=(draws, len(curves)))
    drawn = np.sort([first_below(curves[pick].mean(axis=0), level) for pick in picks])
    low, high = drawn[int(0.025 * (draws - 1))], drawn[math.ceil(0.975 * (draws - 1))]
    return Break(first_below(curves.mean(axis=0), level), float(low), float(high))


def strength_at(strengths: Sequence[Strength], step: float) -> float | None:
    """The strength at a step between those of a sweep; None beyond it, or where strengths are names.

    Interpolated by ratio where strengths are of one sign and span a wide range, by difference otherwise.
    """
    if not math.isfinite(step) or any(isinstance(value, str) for value in strengths):
        return None
    values, at = np.array(strengths, dtype=np.float64), np.arange(len(strengths))
    if (values > 0).all() and values.max() >= GEOMETRIC * values.min():
        return float(np.exp(np.interp(step, at, np.log(values))))
    return float(np.interp(step, at, values))


@dataclass(frozen=True, eq=False)
class Swept:
    """One attack in one reading and direction, all scenes and trials together.

    Arrays are (T, S), a number for each trial and strength, or (S,), means over the scenes.
    """

    name: str  # attack, direction and reading
    kind: str
    strengths: tuple[Strength, ...]  # from harmless to ruinous
    bits: Float64  # (T, S)
    paper: Float64  # (T, S) bits by the paper's rule
    z: Float64  # (T, S)
    claimed: Float64  # (T, S)
    bits_baselines: dict[str, Float64]  # each (S,), NaN where a baseline was not read
    psnr: Float64  # (S,) what is left of the look, dB; NaN where nothing says so
    coverage: Float64  # (S,) share of what is to be seen that an attacked model still covers; NaN for pictures
    z_threshold: float
    by_looking: dict[Strength, float]  # z of the renders where the Gaussians first gave no claim, least of the scenes

    @property
    def label(self) -> str:
        """The name as figures show it."""
        return self.name.replace("-as_code", " (as code)").replace("_", " ")

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
        known = np.flatnonzero(np.isfinite(self.psnr))
        return float(np.interp(step, known, self.psnr[known])) if len(known) else None

    def coverage_at(self, step: float) -> float | None:
        """Share between two strengths; None where it was not measured."""
        if not np.isfinite(self.coverage).all():
            return None
        return float(np.interp(step, np.arange(len(self.coverage)), self.coverage))

    def strength_of(self, step: float) -> float | str | None:
        """The strength at a step; a name where strengths are names."""
        if not self.ordered and math.isfinite(step):
            return str(self.strengths[min(math.ceil(step), len(self.strengths) - 1)])
        return strength_at(self.strengths, step)

    def claims_interval(self, step: int) -> tuple[float, float]:
        """Exact 95 % interval of the share of claims."""
        return share_interval(int(self.claimed[:, step].sum()), len(self.claimed))

    def z_interval(self, step: int) -> tuple[float, float]:
        """Bootstrap 95 % interval of the mean z."""
        return bootstrap(list(self.z[:, step]))


def sum_up(rows: Sequence[Row]) -> list[Swept]:
    """Curves of all sweeps; a trial that could not be run at some strength is left out."""
    own = [{**row, "sweep": row["cell"].split("-", 1)[1]} for row in picked(rows, what="sweep") if "refused" not in row]
    return [_swept(name, kind, swept) for (name, kind), swept in grouped(own, "sweep", "kind").items()]


def _swept(name: str, kind: str, rows: Sequence[Row]) -> Swept:
    steps = dict(sorted(grouped(rows, "step").items()))
    trials = [{row["step"]: row for row in own} for own in grouped(rows, "cell", "trial").values()]

    def table(field: str) -> Float64:
        return np.array([[float(trial[k][field]) for k in steps] for trial in trials if len(trial) == len(steps)])

    def over_steps(field: str) -> Float64:
        return np.array([_mean(row.get(field) for row in own) for own in steps.values()])

    baselines = sorted({key for row in rows for key in row if key.startswith("bits_")} - {"bits_paper"})
    looked: dict[Strength, float] = {}
    for row in rows:
        if "z_by_looking" in row:
            looked[row["strength"]] = min(looked.get(row["strength"], math.inf), row["z_by_looking"])
    return Swept(
        name=name,
        kind=kind,
        strengths=tuple(own[0]["strength"] for own in steps.values()),
        bits=table("bits"),
        paper=table("bits_paper"),
        z=table("z"),
        claimed=table("claimed"),
        bits_baselines={field.removeprefix("bits_"): over_steps(field) for field in baselines},
        psnr=over_steps("psnr"),
        coverage=over_steps("coverage"),
        z_threshold=max(row["z_threshold"] for row in rows),
        by_looking=looked,
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
        return (0 if claim.lost else 1 if bits.lost else 2, -(look or 0.0), float(one.z[:, -1].mean()))

    return sorted(swept, key=rank)


def draw_map(own: Sequence[Swept], title: str) -> Figure:
    """Bits by each decoder and claims, attack by strength; rows as in the table, failing first."""
    panels: dict[str, list[Float64]] = {
        "claims at 1e-9": [one.claimed.mean(axis=0) for one in own],
        "bits": [one.bits.mean(axis=0) for one in own],
        "bits, paper's rule (Eq 10)": [one.paper.mean(axis=0) for one in own],
    }
    for name in sorted({name for one in own for name in one.bits_baselines}):
        unread = [np.full(len(one.strengths), np.nan) for one in own]
        panels[f"bits, {name}"] = [one.bits_baselines.get(name, none) for one, none in zip(own, unread, strict=True)]
    height = 1.1 + 0.165 * max(len(own), 4)
    drawn, axes = figure(1, len(panels), width=3.2 + 1.6 * len(panels), height=height, squeeze=False, title=title)
    pictures: list[Any] = []
    for axis, (name, curves) in zip(axes[0], panels.items(), strict=True):
        shown = np.array([_stretched(curve, one.ordered) for curve, one in zip(curves, own, strict=True)])
        least = 0.5 if pictures else 0.0
        pictures.append(
            axis.imshow(shown, cmap=SEQUENTIAL, vmin=least, vmax=1.0, aspect="auto", interpolation="nearest")
        )
        axis.set_facecolor("#ffffff")
        axis.grid(False)
        axis.set_title(name, fontsize=8.0)
        axis.set_xticks([0, COLUMNS - 1], ["harmless", "ruinous"], fontsize=6.5)
        for label, side in zip(axis.get_xticklabels(), ("left", "right"), strict=True):
            label.set_horizontalalignment(side)
        axis.set_yticks(range(len(own)), [one.label for one in own] if axis is axes[0, 0] else [])
        axis.tick_params(axis="y", labelsize=6.5, length=0)
    scales = (((0.0, 0.5, 1.0), "claims"), ((0.5, 0.75, 1.0), "bits (0.5 and less: lost)"))
    for picture, (ticks, name) in zip(pictures, scales, strict=False):
        bar = drawn.colorbar(picture, ax=axes[0], pad=0.01, fraction=0.012, aspect=30, ticks=ticks)
        bar.set_label(name, fontsize=6.5)
        bar.ax.tick_params(labelsize=6.5)
    return drawn


def _stretched(curve: Float64, ordered: bool) -> Float64:
    """(COLUMNS,) a sweep at the map's length: between strengths the line, between kinds the nearest."""
    at = np.linspace(0, len(curve) - 1, COLUMNS)
    stretched: Float64 = np.interp(at, np.arange(len(curve)), curve)
    return stretched if ordered else curve[np.round(at).astype(int)]
