"""Figures of cost: growth on log-log axes, the roofline, bytes by format.

A cost grows as c * size^k, fitted on logarithms.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import cycle

import numpy as np
from scipy.stats import linregress, t

from engine.lab.evaluate.figures import FAINT, INK, Figure, figure, styles
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


def draw_roofline(rows: Sequence[Row]) -> Figure:
    """Operations a second over operations a byte, under what the machine can do."""
    drawn, axes = figure(width=6.4, height=3.8)
    axes.set_xscale("log")
    axes.set_yscale("log")
    peak, bandwidth = max(row["peak_flops"] for row in rows), max(row["peak_bytes"] for row in rows)
    ridge = peak / bandwidth
    x = np.geomspace(min(1.0, ridge / 4), max(200.0, 4 * ridge), 100)
    axes.plot(x, np.minimum(peak, x * bandwidth) / 1e9, color=INK)
    note = partial(axes.annotate, textcoords="offset points", fontsize=8, color=INK)
    left = 1.3 * x[0]
    note(f"{bandwidth / 1e9:.0f} GB/s", (left, left * bandwidth / 1e9), xytext=(0, -14))
    note(f"{peak / 1e9:.0f} GFLOP/s", (x[-1], peak / 1e9), xytext=(0, 4), ha="right")
    for row, style in zip(rows, styles(), strict=False):
        at, achieved, attainable = row["flops_per_byte"], row["achieved_flops"] / 1e9, row["attainable_flops"] / 1e9
        axes.plot([at, at], [achieved, attainable], color=FAINT, linestyle=":", linewidth=1.0)
        label = f"{row['scene']}: {achieved:.0f} GFLOP/s, {100 * row['fraction']:.0f} % of attainable"
        axes.plot(at, achieved, **{**style, "linestyle": "none"}, markersize=7, label=label)
    by_arithmetic = all(row["flops_per_byte"] > ridge for row in rows)
    axes.set(
        xlabel="operations a byte of memory traffic (log scale)",
        ylabel="GFLOP/s (log scale)",
        title="The forward kernel is bound by arithmetic, not by memory"
        if by_arithmetic
        else "The forward kernel under the machine's roof",
    )
    axes.legend(loc="lower right")
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
