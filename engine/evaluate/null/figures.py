"""Figures of the calibration: false claims, ROC, power, detectability, and the oracle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import norm

from engine.evaluate.drawing import FAINT, INK, figure, house_style, label_line, styles
from engine.evaluate.intervals import share_interval
from engine.evaluate.null.counting import LOG10_THRESHOLDS
from engine.evaluate.null.rates import Rates, share_claimed
from engine.evaluate.study import Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_detectability", "draw_false_claims", "draw_oracle", "draw_power", "draw_roc"]

LEAST_SHARE = 1e-8


def draw_false_claims(groups: Sequence[Rates], wrong: Rates | None, title: str) -> Figure:
    """Measured share of claims against the stated bound, log-log; the mistaken detector far above."""
    drawn, axis = figure(width=6.4, height=4.6)
    axes: Axes = axis
    bounds = 10.0 ** np.array(LOG10_THRESHOLDS)
    with house_style():
        axes.plot(bounds, bounds, color=INK, linewidth=1.2, label="the bound, exp(-z²/2)")
        limits = np.sqrt(-2.0 * np.log(bounds))
        axes.plot(bounds, norm.sf(limits), color=FAINT, linewidth=1.2, linestyle=(0, (1, 1)), label="normal tail")
        for style, rates in zip(styles(), groups, strict=False):
            seen = rates.shares > 0
            spread = np.maximum(rates.intervals[seen], LEAST_SHARE)
            axes.plot(
                bounds[seen],
                rates.shares[seen],
                label=f"{rates.name}: {rates.keys:,} keys",
                **{**style, "linestyle": "none"},
            )
            axes.vlines(bounds[seen], spread[:, 0], spread[:, 1], color=style["color"], linewidth=1.0)
        if wrong is not None and wrong.keys:
            axes.plot(
                bounds,
                wrong.shares,
                color=INK,
                marker="x",
                linestyle="-.",
                linewidth=1.0,
                label=f"a mistaken detector: {wrong.keys:,} keys",
            )
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlim(1.0, 1e-9)
        axes.set_ylim(LEAST_SHARE, 3.0)
        axes.set_xlabel("stated bound of a false claim")
        axes.set_ylabel("measured share of wrong keys, 95 % intervals")
        axes.legend(loc="lower left", fontsize=7.0)
        axes.set_title(title)
    return drawn


def draw_roc(groups: dict[str, list[Row]], title: str) -> Figure:
    """Share of right claims against the stated bound of a false one, for thin and thinner evidence."""
    drawn, axis = figure(width=6.4, height=4.0)
    axes: Axes = axis
    log10 = np.linspace(-12.0, -0.02, 200)
    with house_style():
        for style, (name, rows) in zip(styles(), groups.items(), strict=False):
            shares = [share_claimed([row["z"] for row in rows], float(value)) for value in log10]
            axes.plot(10.0**log10, shares, label=name, markevery=20, **style)
        axes.plot(10.0**log10, 10.0**log10, color=FAINT, linewidth=1.0, linestyle=(0, (1, 1)), label="chance")
        axes.set_xscale("log")
        axes.set_xlim(1e-12, 1.0)
        label_line(axes, 1e-9, "", along="y")
        axes.text(1.3e-9, 0.03, "a claim", fontsize=7.5, color="#6a6a6a")
        axes.set_xlabel("bound of a false claim (proven; the measured rate lies below)")
        axes.set_ylabel("share of marked suspects claimed")
        axes.legend(fontsize=7.0, loc="best")
        axes.set_title(title)
    return drawn


def draw_power(gaussians: Sequence[Row], pictures: Sequence[Row], title: str) -> Figure:
    """Share of claims at 1e-9 against the amount of evidence."""
    drawn, axes = figure(1, 2, width=8.4, height=3.6, sharey=True)
    with house_style():
        for axis, rows, label in (
            (axes[0], gaussians, "Gaussians left of the model"),
            (axes[1], pictures, "small noisy pictures together"),
        ):
            scenes = list(dict.fromkeys(row["scene"] for row in rows))
            for style, scene in zip(styles(), scenes, strict=False):
                amounts = sorted({row["amount"] for row in rows if row["scene"] == scene})
                shares, spread = [], []
                for amount in amounts:
                    z = [row["z"] for row in rows if row["scene"] == scene and row["amount"] == amount]
                    hits = round(share_claimed(z, -9.0) * len(z))
                    shares.append(hits / len(z))
                    spread.append(share_interval(hits, len(z)))
                low, high = np.array(spread).T
                axis.plot(amounts, shares, label=scene, **style)
                axis.vlines(amounts, low, high, color=style["color"], linewidth=1.0)
            ticks = sorted({row["amount"] for row in rows if row["scene"] == scenes[0]})
            axis.set_xscale("log")
            axis.set_xticks(ticks, [f"{tick:,}" for tick in ticks])
            axis.minorticks_off()
            axis.set_xlabel(label)
            axis.set_ylim(-0.03, 1.03)
        axes[0].set_ylabel("share claimed at 1e-9, 95 %")
        axes[0].legend(fontsize=7.0)
        drawn.suptitle(title, x=0.01, ha="left", fontsize=10.0, fontweight="bold")
    return drawn


def draw_detectability(rows: Sequence[Row], title: str) -> Figure:
    """Sinkhorn divergence of each comparison as a multiple of the chance level's median."""
    names = list(dict.fromkeys((row["features"], row["against"]) for row in rows))
    drawn, axis = figure(width=6.8, height=0.9 + 0.42 * max(len(names), 2))
    axes: Axes = axis
    with house_style():
        for style, scene in zip(styles(), dict.fromkeys(row["scene"] for row in rows), strict=False):
            own = [row for row in rows if row["scene"] == scene]
            axes.plot(
                [max(row["distance"] / row["null_median"], 0.1) for row in own],
                [names.index((row["features"], row["against"])) for row in own],
                label=scene,
                **{**style, "linestyle": "none"},
            )
        for number, name in enumerate(names):
            own = [row for row in rows if (row["features"], row["against"]) == name]
            highest = max(row["null_highest"] / row["null_median"] for row in own)
            label = "as far as chance reached" if number == 0 else None
            axes.barh(number, highest - 0.1, left=0.1, height=0.5, color="#e2e2e2", zorder=0, label=label)
        axes.set_yticks(range(len(names)), [f"{features}: {against}" for features, against in names])
        axes.set_ylim(-0.5, len(names) - 0.5)
        axes.set_xscale("log")
        ticks = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
        largest = max((row["distance"] / row["null_median"] for row in rows), default=1.0)
        axes.set_xlim(0.1, 1.5 * max(largest, 3.0))
        axes.set_xticks([tick for tick in ticks if tick < 1.5 * max(largest, 3.0)])
        axes.xaxis.set_major_formatter("{x:g}")
        axes.minorticks_off()
        axes.set_xlabel("Sinkhorn divergence, in medians of chance")
        drawn.legend(fontsize=7.0, loc="outside lower center", ncols=4)
        drawn.suptitle(title, x=0.01, ha="left", fontsize=10.0, fontweight="bold")
    return drawn


def draw_oracle(rows: Sequence[Row], title: str) -> Figure:
    """z of a forged pattern against the questions asked."""
    drawn, axis = figure(width=6.4, height=3.4)
    axes: Axes = axis
    queries = sorted({row["queries"] for row in rows})
    with house_style():
        series = (("z_told_z", "answers tell z"), ("z_told_verdict", "answers tell the verdict alone"))
        for style, (field, label) in zip(styles(), series, strict=False):
            values = [[row[field] for row in rows if row["queries"] == count] for count in queries]
            axes.plot(queries, [np.mean(own) for own in values], label=label, **style)
            axes.vlines(queries, [min(own) for own in values], [max(own) for own in values], color=style["color"])
        label_line(axes, rows[0]["z_threshold"], "claim at 1e-9")
        axes.set_xscale("log")
        axes.set_xlabel("questions to the owner's detector")
        axes.set_ylabel("z of the forged pattern, mean and range")
        axes.legend(fontsize=7.0, loc="upper left")
        axes.set_title(title)
    return drawn
