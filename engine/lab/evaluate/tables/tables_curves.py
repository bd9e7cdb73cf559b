"""Settings side by side, paired so that only the setting differs; and curves over one knob at a time."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean

from engine.lab.evaluate.figures import Axes, label_line, styles
from engine.lab.evaluate.intervals import bootstrap
from engine.lab.evaluate.study import Row, Table
from engine.lab.evaluate.summary import accuracy, mean_text, picked, share_text, table
from engine.lab.evaluate.tables.part import CONDITIONS, Setting, rows_of_setting


@dataclass(frozen=True)
class Effect:
    """Change of z against the base, in per cent, with a bootstrap interval over the pairs."""

    percent: float
    low: float
    high: float
    pairs: int

    @property
    def is_clear(self) -> bool:
        """Whether the interval leaves out no change at all."""
        return self.low > 0.0 or self.high < 0.0

    def __str__(self) -> str:
        return f"{self.percent:+.1f} % ({self.low:+.1f} to {self.high:+.1f})"


def effect(rows: Sequence[Row], setting: str, base: str, condition: str) -> Effect | None:
    """Of a setting on z: of pictures after an attack, or of the model itself for ``"model"``; None without pairs.

    A pair is two readings that differ in nothing else; where either is no evidence, there is none.
    """
    mine, its = (_by_place(rows, name, condition) for name in (setting, base))
    logs = [math.log(mine[at] / its[at]) for at in mine if at in its and min(mine[at], its[at]) > 0.0]
    if not logs:
        return None
    percent, low, high = (100.0 * math.expm1(value) for value in (fmean(logs), *bootstrap(logs)))
    return Effect(percent, low, high, len(logs))


def _by_place(rows: Sequence[Row], setting: str, condition: str) -> dict[tuple[object, ...], float]:
    wanted = {"kind": "marked"} if condition == "model" else {"kind": "picture", "attack": condition}
    found = picked(rows, setting=setting, **wanted)
    return {(row["scene"], row["seed"], row.get("view")): float(row["z"]) for row in found}


@dataclass(frozen=True)
class Knob:
    """A knob, named as an axis is labelled, the settings along it, and the value that the profile uses."""

    name: str
    points: dict[float, Setting]
    ours: float
    paper: float | None = None
    """Where the paper finds its best."""
    log: bool = False


def knob_table(knobs: Iterable[Knob], rows: Sequence[Row]) -> Table:
    """One line a point: value, bits and z under each condition, fidelity, seconds; or why it was refused."""
    bits, z = ({name: f"{what}, {name}" for name in CONDITIONS} for what in ("bits", "z"))
    columns = ("knob", "value", *bits.values(), *z.values(), "PSNR to the original, dB", "embed, s")
    lines: list[Row] = []
    for knob in knobs:
        for value, setting in knob.points.items():
            of, about = rows_of_setting(rows, setting.name), {"knob": knob.name, "value": value}
            if of["refused"]:
                lines.append({**dict.fromkeys(columns), **about, "embed, s": of["refused"][0]["reason"]})
            if of["marked"]:
                for name in CONDITIONS:
                    pictures = picked(of["picture"], attack=name)
                    about[bits[name]] = share_text(accuracy(pictures))
                    about[z[name]] = mean_text([row["z"] for row in pictures])
                about["PSNR to the original, dB"] = mean_text([row["psnr"] for row in of["view"]])
                lines.append({**about, "embed, s": f"{fmean(row['embed_seconds'] for row in of['marked']):.1f}"})
    return table(lines, *columns, title="Every point")


def draw_knob(axes: Axes, knob: Knob, rows: Sequence[Row], xs: Sequence[float] | None = None) -> None:
    """z of one picture over the knob, one curve a condition, bars for the bootstrap over views and keys.

    `xs` are the places of the points where they are not the knob's own values.
    """
    values = list(knob.points)
    places = dict(zip(values, xs or values, strict=True))
    for condition, style in zip(CONDITIONS, styles(), strict=False):
        drawn = []
        for value, setting in knob.points.items():
            z = [row["z"] for row in picked(rows, setting=setting.name, kind="picture", attack=condition)]
            if z:
                mean, (low, high) = fmean(z), bootstrap(z)
                drawn.append((places[value], mean, mean - low, high - mean))
        if drawn:
            x, means, below, above = zip(*drawn, strict=True)
            label = "no attack" if condition == "none" else condition
            axes.errorbar(x, means, yerr=[below, above], capsize=2, label=label, **style)
    axes.set_xlabel(knob.name)
    axes.set_ylim(bottom=0)
    if knob.log:
        axes.set_xscale("log")
        axes.set_xticks(values, [f"{value:g}" for value in values])
        axes.minorticks_off()
    if knob.ours in places:
        label_line(axes, places[knob.ours], "ours", along="y")
    if knob.paper is not None and knob.paper != knob.ours:
        label_line(axes, knob.paper, "the paper's best", along="y")
