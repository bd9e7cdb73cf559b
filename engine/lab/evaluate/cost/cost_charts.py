"""Figures of cost: growth on log-log axes, bytes by format.

A cost grows as c * size^k, fitted on logarithms.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle

import numpy as np
from scipy.stats import linregress, t

from engine.lab.evaluate.figures import Figure, figure, styles
from engine.lab.evaluate.study import Row


@dataclass(frozen=True)
class Growth:
    """Exponent k with its 95 % interval (None with fewer than three points), and the factor c."""

    exponent: float
    interval: tuple[float, float] | None
    factor: float

    def __str__(self) -> str:
        if self.interval is None:
            return f"{self.exponent:.2f}"
        return f"{self.exponent:.2f} ({self.interval[0]:.2f} to {self.interval[1]:.2f})"


def fit_growth(sizes: Sequence[float], costs: Sequence[float]) -> Growth:
    """Least squares of log cost on log size; the interval is Student's, from the scatter about the line.

    ValueError with fewer than two sizes, or something that is not positive.
    """
    x, y = np.asarray(sizes, dtype=np.float64), np.asarray(costs, dtype=np.float64)
    if len(np.unique(x)) < 2 or len(x) != len(y):
        raise ValueError(f"a growth needs two sizes or more, got {list(sizes)} with {len(y)} costs")
    if (x <= 0).any() or (y <= 0).any():
        raise ValueError("sizes and costs must be positive")
    line = linregress(np.log(x), np.log(y))
    interval = None
    if len(x) > 2:
        half = float(t.ppf(0.975, len(x) - 2) * line.stderr)
        interval = (float(line.slope) - half, float(line.slope) + half)
    return Growth(float(line.slope), interval, float(np.exp(line.intercept)))


Curve = tuple[Sequence[float], Sequence[float], Growth]
"""Sizes, costs, and the growth fitted to them."""
HATCHES = ("", "//", "..", "xx", "\\\\", "++", "oo")


def draw_growth(curves: Mapping[str, Curve], x_label: str, y_label: str, title: str) -> Figure:
    """Costs over sizes on log-log axes; the legend says the exponents."""
    drawn, axes = figure(width=8.2, height=4.2)
    axes.set_xscale("log")
    axes.set_yscale("log")
    for (name, (sizes, costs, growth)), style in zip(curves.items(), styles(), strict=False):
        axes.plot(sizes, costs, label=f"{name}: exponent {growth.exponent:.2f}", **style)
    sizes = sorted({size for curve in curves.values() for size in curve[0]})
    axes.set_xticks(sizes, [_count(size) for size in sizes])
    axes.minorticks_off()
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set(xlabel=x_label, ylabel=y_label, title=title)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return drawn


def draw_formats(rows: Sequence[Row]) -> Figure:
    """Bytes a Gaussian by format, one group of bars a scene."""
    scenes = list(dict.fromkeys(str(row["scene"]) for row in rows))
    formats = list(dict.fromkeys(str(row["format"]) for row in rows))
    drawn, axes = figure(width=6.4, height=3.6)
    wide = 0.8 / len(scenes)
    sizes = {(str(row["scene"]), str(row["format"])): row["bytes"] / row["gaussians"] for row in rows}
    for number, (scene, style, hatch) in enumerate(zip(scenes, styles(), cycle(HATCHES), strict=False)):
        values = [sizes.get((scene, name), 0.0) for name in formats]
        places = np.arange(len(formats)) + (number - (len(scenes) - 1) / 2) * wide
        look = {"color": style["color"], "edgecolor": "white", "hatch": hatch}
        drawn_bars = axes.bar(places, values, 0.92 * wide, label=scene, **look)
        axes.bar_label(drawn_bars, fmt="%.0f", fontsize=7.5)
    first = {name: sizes[scenes[0], name] for name in formats if (scenes[0], name) in sizes}
    least, largest = min(first, key=first.__getitem__), max(first, key=first.__getitem__)
    axes.set_xticks(range(len(formats)), [f".{name}" for name in formats])
    axes.grid(visible=False, axis="x")
    axes.set(
        ylim=(0, 1.12 * max(sizes.values())),
        ylabel="bytes a Gaussian",
        title=f"{scenes[0]}: from {first[least]:.0f} bytes a Gaussian (.{least}) to {first[largest]:.0f} (.{largest})",
    )
    axes.legend()
    return drawn


def _count(value: float) -> str:
    for unit, name in ((1e6, "M"), (1e3, "k")):
        if value >= unit:
            return f"{value / unit:g}{name}"
    return f"{value:g}"
