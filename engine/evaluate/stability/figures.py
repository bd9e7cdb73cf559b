"""Heat maps of attack by strength, and the curves of those that break first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from engine.evaluate.drawing import SEQUENTIAL, figure, label_line, spread_curve, styles
from engine.evaluate.stability.curves import Swept
from engine.model import Float64
from engine.sim.cost import CHEAP_DB

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_costs", "draw_map"]

COLUMNS = 25
"""Of a map: every sweep is stretched to the same length, harmless to ruinous."""


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


def draw_costs(own: Sequence[Swept], what: str, most: int = 6) -> Figure:
    """z against what is left of the look, for the attacks that take the claim, or come nearest to it."""
    worst = [one for one in own if np.isfinite(one.psnr).sum() >= 2 and one.ordered][:most]
    drawn, axes = figure(height=4.0)
    for style, one in zip(styles(), worst, strict=False):
        spread = np.array([one.z_interval(step) for step in range(len(one.strengths))])
        mean, low, high = (np.maximum(z, 1.0) for z in (one.z.mean(axis=0), *spread.T))
        spread_curve(axes, np.minimum(one.psnr, 60.0), mean, low, high, thin=1.6, label=one.label, **style)
    axes.set(yscale="log", ylim=(0.9, None))
    axes.invert_xaxis()
    label_line(axes, max((one.z_threshold for one in worst), default=6.4), "claim at 1e-9")
    label_line(axes, CHEAP_DB, "", along="y")
    lost = f"below {CHEAP_DB:g} dB\nthe look is lost"
    axes.text(CHEAP_DB - 0.4, 0.02, lost, fontsize=7.5, color="#6a6a6a", transform=axes.get_xaxis_transform())
    axes.set_xlabel("look that is left: PSNR against the marked model, dB (60 and more at 60)")
    axes.set_ylabel("z, mean and 95 % interval (1 and less at 1)")
    axes.legend(fontsize=7.0, loc="lower left")
    cheap = sum(one.is_cheap for one in own)
    finding = f"{cheap} of {len(own)} take the claim and keep" if cheap else "no attack takes the claim and keeps"
    axes.set_title(f"Attacks on {what}: {finding} {CHEAP_DB:g} dB")
    return drawn
