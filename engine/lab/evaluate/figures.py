"""One look for all figures: readable in grey, by colour-blind people, and on paper; the same bytes every time.

Reports draw in `house_style`. Axes take their words and scales by matplotlib's own ``axes.set(...)``.
"""

import io
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import cycle
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure

__all__ = [
    "FAINT",
    "INK",
    "MARKERS",
    "SEQUENTIAL",
    "Axes",
    "Figure",
    "figure",
    "house_style",
    "label_line",
    "png",
    "styles",
    "svg",
]

Axes: TypeAlias = "matplotlib.axes.Axes"
Figure: TypeAlias = "matplotlib.figure.Figure"
"""matplotlib's own, which is loaded only by what draws."""

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito (2008); neighbours in the list also differ in lightness."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
DASHES: tuple[Any, ...] = ("-", "--", ":", "-.", (0, (5, 1)), (0, (3, 1, 1, 1)), (0, (1, 1)))
SEQUENTIAL = "cividis"
"""A colour map whose lightness says what its colour says."""
TITLE_LETTERS = 11.5
"""Of a bold title of 10 points, an inch."""
INK, FAINT = "#1a1a1a", "#9a9a9a"

STYLE: dict[str, str | float | bool] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": INK,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "lines.linewidth": 1.6,
    "lines.markersize": 5.0,
    "svg.hashsalt": "mark3dgs",
    "svg.fonttype": "path",
    "figure.constrained_layout.use": True,
}


@contextmanager
def house_style() -> Iterator[None]:
    """The settings in force while a figure is drawn: titles and legends read theirs when they are added."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        yield


def figure(
    rows: int = 1, columns: int = 1, *, width: float = 6.4, height: float = 3.8, title: str = "", **options: Any
) -> tuple[Figure, Any]:
    """A figure and its axes in the house style; sizes in inches. It belongs to no window and no global state.

    The title stands above all axes.
    """
    from matplotlib.figure import Figure

    with house_style():
        made = Figure(figsize=(width, height), layout="constrained")
        axes = made.subplots(rows, columns, **options)
        if title:
            made.suptitle(title, x=0.01, ha="left", fontsize=10.0, fontweight="bold")
    return made, axes


def styles() -> Iterator[dict[str, Any]]:
    """Colour, marker and dash for one series after the other, so that color is never the only difference."""
    for color, marker, dash in zip(cycle(PALETTE), cycle(MARKERS), cycle(DASHES), strict=False):
        yield {"color": color, "marker": marker, "linestyle": dash}


def label_line(axes: Axes, value: float, text: str, *, above: bool = True) -> None:
    """A thin level line for a threshold or bar, named at its right end, above or below."""
    axes.axhline(value, color=FAINT, linewidth=1.0, linestyle=(0, (4, 2)), zorder=1)
    look: Any = {"ha": "right", "va": "bottom" if above else "top", "fontsize": 7.5, "color": "#6a6a6a"}
    axes.text(0.99, value, text, transform=axes.get_yaxis_transform(), **look)


def svg(drawn: Figure) -> bytes:
    """The figure as SVG, without a date."""
    return _bytes(drawn, "svg", metadata={"Date": None})


def png(drawn: Figure, dpi: int = 160) -> bytes:
    """The figure as PNG."""
    return _bytes(drawn, "png", dpi=dpi, metadata={"Software": None})


def _bytes(drawn: Figure, kind: str, **options: Any) -> bytes:
    out = io.BytesIO()
    with house_style():
        _wrap_titles(drawn)
        drawn.savefig(out, format=kind, facecolor="white", **options)
    return out.getvalue()


def _wrap_titles(drawn: Figure) -> None:
    """Break titles that would run out of the picture or into the next panel."""
    inches = float(drawn.get_figwidth())
    _wrap(drawn, drawn.get_suptitle(), inches)
    for axes in drawn.axes:
        place = axes.get_subplotspec()
        columns = 1.0 if place is None else place.get_gridspec().ncols / len(place.colspan)
        _wrap(axes, axes.get_title("left"), inches / columns)


def _wrap(holder: Any, title: str, inches: float) -> None:
    """Break a title of a figure or of axes where it is longer than the room it has."""
    from matplotlib.text import Text

    for text in holder.findobj(Text) if title else []:
        if isinstance(text, Text) and text.get_text() == title:
            room = TITLE_LETTERS * inches * 10.0 / float(text.get_fontsize())
            lines = textwrap.wrap(title, max(12, int(room)))
            if len(lines) > title.count("\n") + 1:
                text.set_text("\n".join(lines))
