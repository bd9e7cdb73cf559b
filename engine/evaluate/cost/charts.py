"""Figures of cost: growth on log-log axes, the roofline, bytes by format."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from engine.evaluate.cost.growth import Growth
from engine.evaluate.drawing import FAINT, INK, figure, styles
from engine.evaluate.study import Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Curve", "draw_formats", "draw_growth", "draw_roofline"]

Curve = tuple[Sequence[float], Sequence[float], Growth | None]
"""Sizes, costs, and the growth fitted to them."""


def draw_growth(curves: Mapping[str, Curve], x_label: str, y_label: str, title: str) -> Figure:
    """Costs over sizes on log-log axes; the legend says the exponents."""
    drawn, axes = figure(width=8.2, height=4.2)
    axes.set_xscale("log")
    axes.set_yscale("log")
    for (name, (sizes, costs, growth)), style in zip(curves.items(), styles(), strict=False):
        label = name if growth is None else f"{name}: exponent {growth.exponent:.2f}"
        axes.plot(sizes, costs, label=label, **style)
    sizes = sorted({size for curve in curves.values() for size in curve[0]})
    axes.set_xticks(sizes, [_count(size) for size in sizes])
    axes.minorticks_off()
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    axes.set_title(title)
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
    axes.annotate(
        f"{bandwidth / 1e9:.0f} GB/s",
        (x[0] * 1.3, x[0] * 1.3 * bandwidth / 1e9),
        xytext=(0, -14),
        textcoords="offset points",
        fontsize=8,
        color=INK,
    )
    axes.annotate(
        f"{peak / 1e9:.0f} GFLOP/s",
        (x[-1], peak / 1e9),
        xytext=(0, 4),
        textcoords="offset points",
        fontsize=8,
        ha="right",
    )
    for row, style in zip(rows, styles(), strict=False):
        achieved = row["achieved_flops"] / 1e9
        axes.plot(
            [row["flops_per_byte"]] * 2,
            [achieved, row["attainable_flops"] / 1e9],
            color=FAINT,
            linestyle=":",
            linewidth=1.0,
        )
        axes.plot(
            row["flops_per_byte"],
            achieved,
            linestyle="none",
            color=style["color"],
            marker=style["marker"],
            markersize=7,
            label=f"{row['scene']}: {achieved:.0f} GFLOP/s, {100 * row['fraction']:.0f} % of attainable",
        )
    axes.set_xlabel("operations a byte of memory traffic (log scale)")
    axes.set_ylabel("GFLOP/s (log scale)")
    axes.set_title(
        "The forward kernel is bound by arithmetic, not by memory"
        if _by_arithmetic(rows, ridge)
        else "The forward kernel under the machine's roof"
    )
    axes.legend(loc="lower right")
    return drawn


def _by_arithmetic(rows: Sequence[Row], ridge: float) -> bool:
    return all(row["flops_per_byte"] > ridge for row in rows)


def draw_formats(rows: Sequence[Row]) -> Figure:
    """Bytes a Gaussian by format, one group of bars a scene."""
    scenes = list(dict.fromkeys(str(row["scene"]) for row in rows))
    formats = list(dict.fromkeys(str(row["format"]) for row in rows))
    drawn, axes = figure(width=6.4, height=3.6)
    wide = 0.8 / len(scenes)
    hatches = ("", "//", "..", "xx", "\\\\", "++", "oo")
    most = 0.0
    for number, (scene, style) in enumerate(zip(scenes, styles(), strict=False)):
        own = {row["format"]: row["bytes"] / row["gaussians"] for row in rows if row["scene"] == scene}
        values = [own.get(name, 0.0) for name in formats]
        places = np.arange(len(formats)) + (number - (len(scenes) - 1) / 2) * wide
        axes.bar(
            places,
            values,
            0.92 * wide,
            color=style["color"],
            edgecolor="white",
            hatch=hatches[number % len(hatches)],
            label=scene,
        )
        for place, value in zip(places, values, strict=True):
            axes.text(place, value, f"{value:.0f}", ha="center", va="bottom", fontsize=7.5)
        most = max(most, *values)
    axes.set_xticks(range(len(formats)), [f".{name}" for name in formats])
    axes.grid(visible=False, axis="x")
    axes.set_ylim(0, 1.12 * most)
    axes.set_ylabel("bytes a Gaussian")
    each = {row["format"]: row["bytes"] / row["gaussians"] for row in rows if row["scene"] == scenes[0]}
    least, largest = min(each, key=lambda name: each[name]), max(each, key=lambda name: each[name])
    axes.set_title(
        f"{scenes[0]}: from {each[least]:.0f} bytes a Gaussian (.{least}) to {each[largest]:.0f} (.{largest})"
    )
    axes.legend()
    return drawn


def _count(value: float) -> str:
    for unit, name in ((1e6, "M"), (1e3, "k")):
        if value >= unit:
            return f"{value / unit:g}{name}"
    return f"{value:g}"
