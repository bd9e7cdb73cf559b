"""The figures of the perceptual study."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from engine.evaluate.drawing import FAINT, figure, styles
from engine.evaluate.perceptual.measuring import COMPARED_QUALITIES
from engine.evaluate.study import Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_pictures", "draw_views"]

COLUMNS = {"original": "unmarked", "marked": "marked", "difference": "difference x20"}
SIDE = 2.3
"""Of one picture, inches."""


def draw_pictures(rows: Sequence[Row], title: str) -> Figure:
    """One line for each profile: unmarked, marked, difference."""
    drawn, axes = figure(
        len(rows), len(COLUMNS), width=SIDE * len(COLUMNS) + 0.4, height=SIDE * len(rows) + 0.5, squeeze=False
    )
    for number, (line, row) in enumerate(zip(axes, rows, strict=True)):
        for place, (name, label) in zip(line, COLUMNS.items(), strict=True):
            place.imshow(_picture(row[name]), interpolation="none")
            place.set(xticks=[], yticks=[])
            place.grid(visible=False)
            for spine in place.spines.values():
                spine.set_visible(False)
            if number == 0:
                place.set_title(label, fontweight="normal")
        line[0].set_ylabel(row["profile"])
    drawn.suptitle(title, x=0.01, ha="left", fontsize=10, fontweight="bold")
    return drawn


def draw_views(rows: Sequence[Row], title: str) -> Figure:
    """FLIP over PSNR, a mark a view; plain JPEGs of the same views beside."""
    drawn, axes = figure()
    free = [row for row in rows if row["kind"] == "free"]
    for quality, marker in zip(COMPARED_QUALITIES, "x+", strict=True):
        axes.plot(
            [row[f"jpeg{quality}_psnr"] for row in free],
            [row[f"jpeg{quality}_flip"] for row in free],
            linestyle="",
            marker=marker,
            color=FAINT,
            label=f"no mark, JPEG {quality}",
        )
    profiles = list(dict.fromkeys(row["profile"] for row in free))
    for style, name in zip(styles(), profiles, strict=False):
        style["linestyle"] = ""
        own = [row for row in free if row["profile"] == name]
        axes.plot(
            [row["psnr"] for row in own],
            [row["flip"] for row in own],
            label=f"marked, {name}",
            markerfacecolor="none",
            **style,
        )
    axes.set(xlabel="PSNR against the unmarked render (dB)", ylabel="mean FLIP (0 = not seen)", ylim=(0, None))
    axes.set_title(title)
    axes.legend()
    return drawn


def _picture(text: str) -> Any:
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(base64.b64decode(text))).convert("RGB"))
