"""Figure 6: bits over the hyper-parameters, the paper's where they exist here, and ours."""

from __future__ import annotations

from typing import TYPE_CHECKING

from engine.evaluate.drawing import figure
from engine.evaluate.study import Cell, Drawing, Options, Row, Section, Table
from engine.evaluate.tables.knob import COLUMNS, Knob, draw_knob, knob_rows
from engine.evaluate.tables.paper import printed
from engine.evaluate.tables.part import Part, setting_cells
from engine.evaluate.tables.sections.table6 import refined
from engine.evaluate.tables.setting import DEFAULT, Setting
from engine.evaluate.tables.words import INTERVALS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TEXT = refined("loss-text", 0.4, 1.0, 0.3)
NO_COUNTERPART = (
    ("tau_unc", "none: displacement falls continuously with certainty, there is no threshold to choose"),
    ("tau_occ", "none: accumulated opacity never exceeds 1, so 1.2 never stops a pixel; transmittance ends it at 1e-4"),
    ("lambda_freq", "weight of detail in the residual codebooks of the compact output; 0 in every profile"),
    ("lambda_msg, lambda_rec, lambda_wavelet", "the same, in a refinement that no profile uses"),
)


def compact(lambda_freq: float = 0.0) -> Setting:
    """Codebooks alone, learnt with this weight of detail."""
    return Setting(f"freq-{lambda_freq:g}", {"output": "compact", "quantize": {"lambda_freq": lambda_freq}})


def knobs(quick: bool) -> list[Knob]:
    """All panels: four of the paper's, three of ours."""
    best = {row["knob"]: row["best"] for row in printed("figure6")}
    if quick:
        return [Knob("texture exponent", {0.0: _plan("texture-0", texture_exponent=0.0), 0.5: DEFAULT}, 0.5)]
    return [
        Knob(
            "lambda_msg",
            {v: TEXT if v == 0.4 else refined(f"msg-{v:g}", v, 1.0, 0.3) for v in (0.1, 0.2, 0.4, 0.8)},
            0.4,
            best["lambda_msg"],
            log=True,
        ),
        Knob(
            "lambda_rec",
            {v: TEXT if v == 1.0 else refined(f"rec-{v:g}", 0.4, v, 0.3) for v in (0.25, 0.5, 1.0, 2.0)},
            1.0,
            best["lambda_rec"],
            log=True,
        ),
        Knob(
            "lambda_wavelet",
            {v: TEXT if v == 0.3 else refined(f"wavelet-{v:g}", 0.4, 1.0, v) for v in (0.05, 0.3, 1.0)},
            0.3,
            best["lambda_wavelet"],
            log=True,
        ),
        Knob("lambda_freq (compact output)", {v: compact(v) for v in (0.0, 0.1, 0.5, 2.0)}, 0.0, best["lambda_freq"]),
        Knob(
            "texture exponent",
            {v: DEFAULT if v == 0.5 else _plan(f"texture-{v:g}", texture_exponent=v) for v in (0.0, 0.25, 0.5, 1.0)},
            0.5,
        ),
        Knob(
            "cells (code vectors)",
            {
                v: DEFAULT if v == 8192 else Setting(f"cells-{v}", {"quantize": {"cells": v}})
                for v in (1024, 2048, 4096, 8192)
            },
            8192,
            log=True,
        ),
        Knob(
            "key views",
            {v: DEFAULT if v == 6 else Setting(f"views-{v}", {"views": v}) for v in (2, 4, 6, 10, 16)},
            6,
            log=True,
        ),
    ]


def cells(options: Options) -> list[Cell]:
    """Every point of every panel."""
    every = {setting.name: setting for knob in knobs(options.quick) for setting in knob.points.values()}
    return setting_cells(options, every.values())


def section(rows: list[Row], options: Options) -> Section:
    """One panel a knob."""
    panels = knobs(options.quick)
    return Section(
        "Figure 6: hyper-parameters",
        [
            "The paper plots bit accuracy over six hyper-parameters and prints only where it peaks. Here bits "
            "saturate, so the curves show z of one picture: an error of a bit becomes likely only when z falls "
            "below about 12 at 32 bits. The peaks of the paper's figure are marked where the knob exists.",
            INTERVALS,
        ],
        [
            Table(("the paper's knob", "here"), NO_COUNTERPART),
            Table(COLUMNS, [line for knob in panels for line in knob_rows(knob, rows)], "Every point"),
        ],
        [
            Drawing(
                "fig6",
                lambda: draw(rows, panels),
                "Strength of the claim (z) of one picture over each knob, bootstrap 95 % over views and keys.",
            )
        ],
    )


def draw(rows: list[Row], panels: list[Knob]) -> Figure:
    """Small multiples with one legend."""
    across = min(4, len(panels))
    down = -(-len(panels) // across)
    drawn, grid = figure(down, across, width=2.5 * across + 0.6, height=2.5 * down + 0.7, squeeze=False, sharey=True)
    every = list(grid.flat)
    for axes, knob in zip(every, panels, strict=False):
        draw_knob(axes, knob, rows)
    for axes in every[len(panels) :]:
        axes.set_axis_off()
    for first in grid[:, 0]:
        first.set_ylabel("z of one picture")
    drawn.suptitle(_finding(rows, panels), x=0.01, ha="left", fontweight="bold", fontsize=10)
    drawn.legend(*every[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return drawn


def _finding(rows: list[Row], panels: list[Knob]) -> str:
    """How much the weakest kind of picture moves over all panels."""
    names = {setting.name for knob in panels for setting in knob.points.values()}
    z: dict[str, list[float]] = {}
    for row in rows:
        if row.get("setting") in names and row.get("attack") == "JPEG 10":
            z.setdefault(row["setting"], []).append(row["z"])
    if len(z) < 2:
        return "Hyper-parameters"
    means = sorted(sum(values) / len(values) for values in z.values())
    return f"Over all these settings, z after JPEG 10 stays between {means[0]:.0f} and {means[-1]:.0f}"


def _plan(name: str, **changes: float) -> Setting:
    return Setting(name, {"plan": changes})


PART = Part("fig6", "Figure 6: hyper-parameters", "Which hyper-parameters matter, and how much?", cells, section)
