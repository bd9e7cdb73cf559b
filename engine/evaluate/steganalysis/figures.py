"""The figures of the steganalysis study."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from engine.evaluate.drawing import FAINT, figure, label_line, styles
from engine.evaluate.steganalysis.lsb import DETECTORS
from engine.evaluate.steganalysis.roc import area, rates
from engine.evaluate.study import Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_areas", "draw_check", "draw_roc"]


def draw_roc(rows: Sequence[Row], title: str) -> Figure:
    """Fusion of the four detectors: our mark, and replaced bits at the lowest rate for scale."""
    drawn, axes = figure(width=5.6, height=4.6)
    unmarked = np.array([row["fusion"] for row in rows if row["kind"] == "unmarked"])
    lsb = sorted({row["rate"] for row in rows if row["kind"] == "lsb"})
    series: list[tuple[str, list[Row]]] = [("our mark", [row for row in rows if row["kind"] == "marked"])]
    weakest = [row for row in rows if row["kind"] == "lsb" and row["rate"] == lsb[0]]
    series.append((f"{100 * lsb[0]:g} % of the LSBs replaced", weakest))
    axes.plot([0, 1], [0, 1], color=FAINT, linewidth=1.0, zorder=1)
    for style, (label, own) in zip(styles(), series, strict=False):
        found = np.array([row["fusion"] for row in own])
        points = rates(unmarked, found, [np.inf, *np.unique(np.concatenate([unmarked, found]))[::-1]])
        axes.plot(
            [p[1] for p in points],
            [p[2] for p in points],
            label=f"{label}: AUC {area(unmarked, found):.3f}",
            markevery=max(1, len(points) // 12),
            **style,
        )
    axes.set(xlabel="false alarms", ylabel="hits", xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), aspect="equal")
    axes.set_title(title)
    axes.legend(loc="lower right")
    return drawn


def draw_check(rows: Sequence[Row], title: str) -> Figure:
    """Estimated over true embedding rate, mean and spread over pictures."""
    drawn, axes = figure()
    checked = [row for row in rows if row["kind"] == "lsb"]
    places = {(row["scene"], row["seed"], row["view"]) for row in checked}
    covers = [row for row in rows if row["kind"] == "unmarked" and (row["scene"], row["seed"], row["view"]) in places]
    true = sorted({row["rate"] for row in checked})
    axes.plot([0, 1], [0, 1], color=FAINT, linewidth=1.0, zorder=1)
    for number, (style, name) in enumerate(zip(styles(), DETECTORS, strict=False)):
        values = [[row[name] for row in covers]]
        values += [[row[name] for row in checked if row["rate"] == rate] for rate in true]
        axes.errorbar(
            np.array([0.0, *true]) + 0.008 * (number - 1.5),
            [np.mean(v) for v in values],
            yerr=[np.std(v) for v in values],
            capsize=2,
            label=name,
            **style,
        )
    axes.set(xlabel="true embedding rate", ylabel="estimated rate, mean and std over pictures")
    axes.set_title(title)
    axes.legend()
    return drawn


def draw_areas(rows: Sequence[Row], title: str) -> Figure:
    """AUC of the learned detectors with intervals, a line for each case."""
    cases = list(dict.fromkeys(_case(row) for row in rows))[::-1]
    drawn, axes = figure(width=7.2, height=1.4 + 0.34 * len(cases))
    names = list(dict.fromkeys(row["classifier"] for row in rows))
    for number, (style, name) in enumerate(zip(styles(), names, strict=False)):
        shift = 0.24 * (0.5 - number / max(len(names) - 1, 1))
        style["linestyle"] = ""
        own = [row for row in rows if row["classifier"] == name]
        axes.errorbar(
            [row["auc"] for row in own],
            [cases.index(_case(row)) + shift for row in own],
            xerr=[[row["auc"] - row["low"] for row in own], [row["high"] - row["auc"] for row in own]],
            capsize=2,
            label=name,
            **style,
        )
    axes.set_yticks(range(len(cases)), cases)
    axes.set(xlabel="AUC of one region of about 512 Gaussians", xlim=(0.4, 1.03), ylim=(-0.6, len(cases) - 0.4))
    label_line(axes, 0.5, "chance", along="y")
    drawn.suptitle(title, x=0.01, ha="left", fontsize=10, fontweight="bold")
    drawn.legend(loc="outside lower right", ncols=2)
    return drawn


def _case(row: Row) -> str:
    whose = "" if row["method"] == "ours" else f"{row['method']}: "
    return f"{whose}{row['attacker']}, {row['form']} ({row['scene']})"
