"""Heat maps of attack by strength, and the curves of those that break first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from engine.evaluate.drawing import SEQUENTIAL, figure, house_style, label_line, styles
from engine.evaluate.stability.summing import Swept
from engine.model import Float64
from engine.sim.cost import CHEAP_DB

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_costs", "draw_map"]

COLUMNS = 25
"""Of a map: every sweep is stretched to the same length, harmless to ruinous."""


def draw_map(swept: Sequence[Swept], kind: str, title: str) -> Figure:
    """Bits by each decoder and claims, attack by strength; rows as in the table, failing first."""
    own = [one for one in swept if one.kind == kind]
    baselines = sorted({name for one in own for name in one.bits_baselines})
    panels: list[tuple[str, list[Float64]]] = [
        ("claims at 1e-9", [one.claimed.mean(axis=0) for one in own]),
        ("bits", [one.bits.mean(axis=0) for one in own]),
        ("bits, paper's rule (Eq 10)", [one.paper.mean(axis=0) for one in own]),
        *(
            (f"bits, {name}", [one.bits_baselines.get(name, np.full(len(one.strengths), np.nan)) for one in own])
            for name in baselines
        ),
    ]
    height = 1.1 + 0.165 * max(len(own), 4)
    drawn, axes = figure(1, len(panels), width=3.2 + 1.6 * len(panels), height=height, squeeze=False)
    pictures = []
    with house_style():
        for column, (axis, (name, curves)) in enumerate(zip(axes[0], panels, strict=True)):
            shown = np.array([_stretched(curve, one.ordered) for curve, one in zip(curves, own, strict=True)])
            picture = axis.imshow(
                shown, cmap=SEQUENTIAL, vmin=0.5 if column else 0.0, vmax=1.0, aspect="auto", interpolation="nearest"
            )
            axis.set_facecolor("#ffffff")
            axis.grid(False)
            axis.set_title(name, fontsize=8.0)
            axis.set_xticks([0, COLUMNS - 1], ["harmless", "ruinous"], fontsize=6.5)
            for label, side in zip(axis.get_xticklabels(), ("left", "right"), strict=True):
                label.set_horizontalalignment(side)
            axis.set_yticks(
                range(len(own)),
                [one.name.replace("-as_code", " (as code)").replace("_", " ") for one in own] if not column else [],
            )
            axis.tick_params(axis="y", labelsize=6.5, length=0)
            pictures.append(picture)
        for picture, ticks, name in (
            (pictures[0], (0.0, 0.5, 1.0), "claims"),
            (pictures[1], (0.5, 0.75, 1.0), "bits (0.5 and less: lost)"),
        ):
            bar = drawn.colorbar(picture, ax=axes[0], pad=0.01, fraction=0.012, aspect=30, ticks=ticks)
            bar.set_label(name, fontsize=6.5)
            bar.ax.tick_params(labelsize=6.5)
        drawn.suptitle(title, x=0.01, ha="left", fontsize=10.0, fontweight="bold")
    return drawn


def _stretched(curve: Float64, ordered: bool) -> Float64:
    """(COLUMNS,) a sweep at the map's length: between strengths the line, between kinds the nearest."""
    at = np.linspace(0, len(curve) - 1, COLUMNS)
    stretched: Float64 = np.interp(at, np.arange(len(curve)), curve)
    return stretched if ordered else curve[np.round(at).astype(int)]


def draw_costs(swept: Sequence[Swept], kind: str, most: int = 6) -> Figure:
    """z against what is left of the look, for the attacks that take the claim, or come nearest to it."""
    judged = [one for one in swept if one.kind == kind and np.isfinite(one.psnr).sum() >= 2 and one.ordered]
    worst = judged[:most]
    drawn, axis = figure(width=6.4, height=4.0)
    axes: Axes = axis
    with house_style():
        threshold = max((one.z_threshold for one in worst), default=6.4)
        for style, one in zip(styles(), worst, strict=False):
            look = np.minimum(one.psnr, 60.0)
            axes.plot(
                look,
                np.maximum(one.z.mean(axis=0), 1.0),
                label=one.name.replace("-as_code", " (as code)").replace("_", " "),
                **style,
            )
            spread = np.array([one.z_interval(step) for step in range(len(one.strengths))])
            axes.vlines(look, np.maximum(spread[:, 0], 1.0), np.maximum(spread[:, 1], 1.0), color=style["color"])
        axes.set_yscale("log")
        axes.set_ylim(0.9, None)
        axes.invert_xaxis()
        label_line(axes, threshold, "claim at 1e-9")
        label_line(axes, CHEAP_DB, "", along="y")
        axes.text(
            CHEAP_DB - 0.4,
            0.02,
            f"below {CHEAP_DB:g} dB\nthe look is lost",
            fontsize=7.5,
            color="#6a6a6a",
            transform=axes.get_xaxis_transform(),
        )
        axes.set_xlabel("look that is left: PSNR against the marked model, dB (60 and more at 60)")
        axes.set_ylabel("z, mean and 95 % interval (1 and less at 1)")
        axes.legend(fontsize=7.0, loc="lower left")
        what = "models" if kind == "model" else "single pictures"
        cheap = sum(one.is_cheap for one in swept if one.kind == kind)
        finding = (
            f"no attack takes the claim and keeps {CHEAP_DB:g} dB"
            if not cheap
            else f"{cheap} of {sum(one.kind == kind for one in swept)} take the claim and keep {CHEAP_DB:g} dB"
        )
        axes.set_title(f"Attacks on {what}: {finding}")
    return drawn
