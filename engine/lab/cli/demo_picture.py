"""The picture that ends the demo: original, marked, what was changed, the stolen piece and the claim."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from engine.model import Float32

GAIN = 20
SIDE = 720
"""Pixels of the three square panels' pictures."""
SUSPECT_SIZE = (720, 540)

_INK, _FAINT, _ACCENT, _PAPER = "#1b1f24", "#5c6672", "#0a7d52", "#ffffff"
_INCHES = (12.0, 8.0)
_LEFT, _GAP, _WIDTH = 0.0225, 0.0125, 0.31


@dataclass(frozen=True, eq=False)
class Panel:
    """One image (H, W, 3) float32 in 0..1, its title and a word beside it."""

    title: str
    caption: str
    image: Float32


def draw_demo(path: Path, original: Panel, marked: Panel, suspect: Panel, headline: str, lines: Sequence[str]) -> None:
    """Write the picture as PNG.

    Parameters
    ----------
    original, marked : Panel
        The same view; their difference is drawn beside them.
    suspect : Panel
        What turned up.
    headline : str
        The verdict in one sentence.
    lines : sequence of str
        The claim, in a fixed-width layout.
    """
    import numpy as np
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    # Mid-grey is no change: both signs of the mark can be seen.
    change = np.clip(0.5 + GAIN * (marked.image - original.image), 0.0, 1.0)
    difference = Panel(f"Difference x{GAIN}", "grey: no change", change.astype(np.float32))
    figure = Figure(figsize=_INCHES, dpi=100, facecolor=_PAPER)
    FigureCanvasAgg(figure)

    def place(panel: Panel, column: int, top: float) -> None:
        height = _WIDTH * panel.image.shape[0] / panel.image.shape[1] * _INCHES[0] / _INCHES[1]
        x = _LEFT + column * (_WIDTH + _GAP)
        axes = figure.add_axes((x, top - height, _WIDTH, height))
        axes.imshow(panel.image, interpolation="antialiased")
        axes.set_axis_off()
        figure.text(x, top + 0.014, panel.title, fontsize=14, fontweight="bold", color=_INK)
        figure.text(x + _WIDTH, top + 0.015, panel.caption, fontsize=8.5, color=_FAINT, ha="right")

    for column, panel in enumerate((original, marked, difference)):
        place(panel, column, 0.94)
    place(suspect, 2, 0.40)
    figure.text(_LEFT, 0.422, headline, fontsize=14, fontweight="bold", color=_ACCENT, va="top")
    text = "\n".join(lines)
    figure.text(_LEFT, 0.376, text, fontsize=8.7, color=_INK, va="top", family="monospace", linespacing=1.3)
    figure.savefig(path, format="png", facecolor=_PAPER, bbox_inches="tight", pad_inches=0.25)  # however long the claim
