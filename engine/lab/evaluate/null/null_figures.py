"""Figures of the calibration: false claims, ROC, power, detectability, and the oracle."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import norm

from engine.lab.evaluate.figures import FAINT, INK, Figure, figure, label_line, spread_curve, styles
from engine.lab.evaluate.intervals import share_interval
from engine.lab.evaluate.null.null_rates import CLAIM, LOG10_THRESHOLDS, Rates, share_claimed
from engine.lab.evaluate.study import Row
from engine.lab.evaluate.summary import distinct, grouped, picked
from engine.watermark.statistics import z_threshold

__all__ = ["draw_detectability", "draw_false_claims", "draw_oracle", "draw_power", "draw_roc"]

LEAST_SHARE = 1e-8


def draw_false_claims(groups: Sequence[Rates], wrong: Rates, title: str) -> Figure:
    """Measured share of claims against the stated bound, log-log; the mistaken detector far above."""
    drawn, axes = figure(height=4.6)
    bounds = 10.0 ** np.array(LOG10_THRESHOLDS)
    tail = norm.sf([z_threshold(bound) for bound in bounds])
    axes.plot(bounds, bounds, color=INK, linewidth=1.2, label="the bound, exp(-z²/2)")
    axes.plot(bounds, tail, color=FAINT, linewidth=1.2, linestyle=(0, (1, 1)), label="normal tail")
    for style, rates in zip(styles(), groups, strict=False):
        seen = rates.shares > 0
        style |= {"linestyle": "none", "label": f"{rates.name}: {rates.keys:,} keys"}
        low, high = np.maximum(rates.intervals[seen], LEAST_SHARE).reshape(-1, 2).T
        spread_curve(axes, bounds[seen], rates.shares[seen], low, high, **style)
    if wrong.keys:
        label = f"a mistaken detector: {wrong.keys:,} keys"
        axes.plot(bounds, wrong.shares, color=INK, marker="x", linestyle="-.", linewidth=1.0, label=label)
    axes.set(xscale="log", yscale="log", xlim=(1.0, 1e-9), ylim=(LEAST_SHARE, 3.0), title=title)
    axes.set(xlabel="stated bound of a false claim", ylabel="measured share of wrong keys, 95 % intervals")
    axes.legend(loc="lower left", fontsize=7.0)
    return drawn


def draw_roc(groups: Mapping[str, Sequence[Row]], title: str) -> Figure:
    """Share of right claims against the stated bound of a false one, for thin and thinner evidence."""
    drawn, axes = figure(height=4.0)
    log10 = np.linspace(-12.0, -0.02, 200)
    for style, (name, rows) in zip(styles(), groups.items(), strict=False):
        shares = [share_claimed([row["z"] for row in rows], float(value)) for value in log10]
        axes.plot(10.0**log10, shares, label=name, markevery=20, **style)
    axes.plot(10.0**log10, 10.0**log10, color=FAINT, linewidth=1.0, linestyle=(0, (1, 1)), label="chance")
    axes.set(xscale="log", xlim=(1e-12, 1.0), title=title, ylabel="share of marked suspects claimed")
    axes.set(xlabel="bound of a false claim (proven; the measured rate lies below)")
    label_line(axes, 1e-9, "", along="y")
    axes.text(1.3e-9, 0.03, "a claim", fontsize=7.5, color="#6a6a6a")
    axes.legend(fontsize=7.0, loc="best")
    return drawn


def draw_power(gaussians: Sequence[Row], pictures: Sequence[Row], title: str) -> Figure:
    """Share of claims at 1e-9 against the amount of evidence."""
    drawn, axes = figure(1, 2, width=8.4, height=3.6, sharey=True, title=title)
    labels = ("Gaussians left of the model", "small noisy pictures together")
    for axis, rows, label in zip(axes, (gaussians, pictures), labels, strict=True):
        ticks: list[int] = []
        for style, (scene, own) in zip(styles(), grouped(rows, "scene").items(), strict=False):
            amounts = sorted(distinct(own, "amount"))
            z = [[row["z"] for row in picked(own, amount=amount)] for amount in amounts]
            shares = [share_claimed(values, CLAIM) for values in z]
            spread = [share_interval(round(s * len(v)), len(v)) for s, v in zip(shares, z, strict=True)]
            spread_curve(axis, amounts, shares, *np.array(spread).T, label=scene, **style)
            ticks = ticks or amounts
        axis.set(xscale="log", xlabel=label, ylim=(-0.03, 1.03))
        axis.set_xticks(ticks, [f"{tick:,}" for tick in ticks])
        axis.minorticks_off()
    axes[0].set_ylabel("share claimed at 1e-9, 95 %")
    axes[0].legend(fontsize=7.0)
    return drawn


def draw_detectability(rows: Sequence[Row], title: str) -> Figure:
    """Sinkhorn divergence of each comparison as a multiple of the chance level's median."""
    names = distinct(rows, "features", "against")
    drawn, axes = figure(width=6.8, height=0.9 + 0.42 * max(len(names), 2), title=title)
    for style, (scene, own) in zip(styles(), grouped(rows, "scene").items(), strict=False):
        far = [max(row["distance"] / row["null_median"], 0.1) for row in own]
        places = [names.index((row["features"], row["against"])) for row in own]
        axes.plot(far, places, label=scene, **{**style, "linestyle": "none"})
    for number, own in enumerate(grouped(rows, "features", "against").values()):
        highest = max(row["null_highest"] / row["null_median"] for row in own)
        label = "as far as chance reached" if number == 0 else None
        axes.barh(number, highest - 0.1, left=0.1, height=0.5, color="#e2e2e2", zorder=0, label=label)
    axes.set_yticks(range(len(names)), [f"{features}: {against}" for features, against in names])
    end = 1.5 * max(3.0, *(row["distance"] / row["null_median"] for row in rows))
    axes.set(ylim=(-0.5, len(names) - 0.5), xscale="log", xlim=(0.1, end))
    axes.set_xticks([tick for tick in (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0) if tick < end])
    axes.xaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    axes.set_xlabel("Sinkhorn divergence, in medians of chance")
    drawn.legend(fontsize=7.0, loc="outside lower center", ncols=4)
    return drawn


def draw_oracle(rows: Sequence[Row], title: str) -> Figure:
    """z of a forged pattern against the number of queries."""
    drawn, axes = figure(height=3.4)
    queries = sorted(distinct(rows, "queries"))
    series = (("z_told_z", "z is revealed"), ("z_told_verdict", "the verdict alone is revealed"))
    for style, (field, label) in zip(styles(), series, strict=False):
        z = [[row[field] for row in picked(rows, queries=count)] for count in queries]
        mean, low, high = ([of(own) for own in z] for of in (np.mean, min, max))
        spread_curve(axes, queries, mean, low, high, thin=1.6, label=label, **style)
    label_line(axes, rows[0]["z_threshold"], "claim at 1e-9")
    axes.set(xscale="log", xlabel="questions to the owner's detector", title=title)
    axes.set_ylabel("z of the forged pattern, mean and range")
    axes.legend(fontsize=7.0, loc="upper left")
    return drawn
