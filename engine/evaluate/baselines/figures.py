"""The figure of the baselines: attack by method."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from engine.evaluate.drawing import SEQUENTIAL, figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_matrix"]

COLUMN_LETTERS = 14
"""What fits above a column."""


def draw_matrix(
    attacks: Sequence[str], methods: Sequence[str], shares: Mapping[tuple[str, str], float], title: str
) -> Figure:
    """Bit accuracy, per cent, as colours and numbers; empty where a method cannot read such a thing."""
    values = np.array([[shares.get((attack, method), np.nan) for method in methods] for attack in attacks])
    drawn, axes = figure(width=3.4 + 1.4 * len(methods), height=1.3 + 0.26 * len(attacks))
    image = axes.imshow(values, cmap=SEQUENTIAL, vmin=50, vmax=100, aspect="auto")
    axes.set_xticks(range(len(methods)), [textwrap.fill(method, COLUMN_LETTERS) for method in methods])
    axes.set_yticks(range(len(attacks)), attacks)
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.grid(visible=False)
    for row in range(len(attacks)):
        for column in range(len(methods)):
            value = values[row, column]
            dark = not np.isnan(value) and value < 78
            text = "-" if np.isnan(value) else f"{value:.1f}"
            axes.text(column, row, text, ha="center", va="center", fontsize=8, color="white" if dark else "black")
    bar = drawn.colorbar(image, ax=axes, shrink=0.6)
    bar.set_label("bits right, %")
    drawn.suptitle(title, x=0.01, ha="left", fontsize=10, fontweight="bold")
    return drawn
