"""Curves over one knob at a time: points, panels and the rows of a table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from engine.evaluate.drawing import label_line, styles
from engine.evaluate.intervals import bootstrap
from engine.evaluate.study import Row
from engine.evaluate.tables.compare import CONDITIONS
from engine.evaluate.tables.part import of_kind
from engine.evaluate.tables.setting import Setting
from engine.evaluate.tables.words import accuracy, mean_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["Knob", "draw_knob", "knob_rows"]


@dataclass(frozen=True)
class Knob:
    """A knob and the settings along it.

    Parameters
    ----------
    name : str
        With its unit, as an axis is labelled.
    points : dict of float to Setting
    ours : float
        Value that the profile uses.
    paper : float, optional
        Where the paper finds its best.
    log : bool
        Axis by ratios.
    """

    name: str
    points: dict[float, Setting]
    ours: float
    paper: float | None = None
    log: bool = False


def knob_rows(knob: Knob, rows: list[Row]) -> Iterator[list[Any]]:
    """One line a point: value, bits and z under each condition, fidelity, seconds."""
    for value, setting in knob.points.items():
        of = of_kind(rows, setting=setting.name)
        marked, refused = of_kind(of, kind="marked"), of_kind(of, kind="refused")
        if refused:
            yield [knob.name, value, *[None] * 7, refused[0]["reason"]]
        if not marked:
            continue
        pictures = [of_kind(of, kind="picture", attack=name) for name in CONDITIONS]
        yield [
            knob.name,
            value,
            *(_bits(p) for p in pictures),
            *(mean_text([row["z"] for row in p]) for p in pictures),
            mean_text([row["psnr"] for row in of_kind(of, kind="view")]),
            f"{sum(row['embed_seconds'] for row in marked) / len(marked):.1f}",
        ]


COLUMNS = (
    "knob",
    "value",
    *(f"bits, {c}" for c in CONDITIONS),
    *(f"z, {c}" for c in CONDITIONS),
    "PSNR to the original, dB",
    "embed, s",
)
"""Of `knob_rows`."""


def draw_knob(axes: Axes, knob: Knob, rows: list[Row], xs: Sequence[float] | None = None) -> None:
    """z of one picture over the knob, one curve a condition, bars for the bootstrap over views and keys.

    `xs` are the places of the points where they are not the knob's own values.
    """
    values = list(knob.points)
    places = dict(zip(values, xs or values, strict=True))
    for condition, style in zip(CONDITIONS, styles(), strict=False):
        drawn = []
        for value, setting in knob.points.items():
            z = [row["z"] for row in of_kind(rows, setting=setting.name, kind="picture", attack=condition)]
            if z:
                mean, (low, high) = sum(z) / len(z), bootstrap(z)
                drawn.append((places[value], mean, mean - low, high - mean))
        if drawn:
            x, mean_, below, above = zip(*drawn, strict=True)
            axes.errorbar(x, mean_, yerr=[below, above], capsize=2, label=_label(condition), **style)
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


def _label(condition: str) -> str:
    return "no attack" if condition == "none" else condition


def _bits(rows: list[Row]) -> str | None:
    found = accuracy(rows)
    return None if found is None else f"{100 * found.share:.1f} % ({100 * found.low:.1f} to {100 * found.high:.1f})"
