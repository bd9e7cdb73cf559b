"""The picture that ends the demo: original, marked, what was changed, and the claim."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from engine.model import Float32

GAIN = 20
INK, FAINT, ACCENT, PAPER = "#1b1f24", "#5c6672", "#0a7d52", "#ffffff"


def draw_demo(
    path: Path,
    original: Float32,
    marked: Float32,
    captions: tuple[str, str],
    headline: str,
    lines: Sequence[str],
) -> None:
    """Write the picture as PNG.

    Parameters
    ----------
    path : Path
    original, marked : (H, W, 3) float32
        The same view, 0..1.
    captions : (str, str)
        Below the two.
    headline : str
        The verdict in one sentence.
    lines : sequence of str
        The claim, in a fixed-width layout.
    """
    import numpy as np
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    # Mid-grey is no change: both signs of the mark can be seen.
    difference = np.clip(0.5 + GAIN * (marked - original), 0.0, 1.0)
    figure = Figure(figsize=(12.0, 8.0), dpi=100, facecolor=PAPER)
    FigureCanvasAgg(figure)
    panels = (
        ("Original", captions[0], original),
        ("Marked", captions[1], marked),
        (f"Difference x{GAIN}", "marked minus original, grey is no change", difference),
    )
    width, gap, left = 0.31, 0.0125, 0.0225
    height = width * 12.0 / 8.0
    for number, (title, caption, image) in enumerate(panels):
        x = left + number * (width + gap)
        axes = figure.add_axes((x, 0.935 - height, width, height))
        axes.imshow(image, interpolation="antialiased")
        axes.set_axis_off()
        figure.text(x, 0.949, title, fontsize=14, fontweight="bold", color=INK)
        figure.text(x + width, 0.950, caption, fontsize=8.5, color=FAINT, ha="right")
    figure.text(left, 0.425, headline, fontsize=14, fontweight="bold", color=ACCENT, va="top")
    figure.text(
        left, 0.378, "\n".join(lines), fontsize=9.3, color=INK, va="top", family="monospace", linespacing=1.32
    )
    figure.savefig(path, format="png", facecolor=PAPER)
