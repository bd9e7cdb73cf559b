"""Ablation: each stage of the pipeline against the pipeline with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from engine.evaluate.drawing import figure, styles
from engine.evaluate.study import Cell, Drawing, Options, Row, Section, Table
from engine.evaluate.tables.compare import CONDITIONS, effect
from engine.evaluate.tables.part import Part, of_kind, setting_cells
from engine.evaluate.tables.sections.fig6 import compact
from engine.evaluate.tables.sections.fig7 import BUDGET_DB, pruned
from engine.evaluate.tables.sections.table6 import refined
from engine.evaluate.tables.setting import DEFAULT, Setting
from engine.evaluate.tables.words import INTERVALS, accuracy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SEEN_AS = ("model", *CONDITIONS)
NAMES = {"model": "the model", "none": "picture", "JPEG 10": "picture, JPEG 10", "noise 0.1": "picture, noise 0.1"}


@dataclass(frozen=True)
class Line:
    """One stage, switched.

    Parameters
    ----------
    stage, change : str
        Which, and what is done to it.
    setting, base : Setting
        With the change, and without.
    """

    stage: str
    change: str
    setting: Setting
    base: Setting = DEFAULT


PRUNED = pruned(BUDGET_DB)
LINES = (
    Line("pruning", f"pruned to {BUDGET_DB:g} dB instead of not at all", PRUNED),
    Line("pruning", "ranked by Eq 4 instead of squared error", pruned(BUDGET_DB, rank="paper"), PRUNED),
    Line("pruning", "gamma 0.2, the paper's, instead of 0", pruned(BUDGET_DB, 0.2), PRUNED),
    Line("pruning", "near-duplicates not merged", pruned(BUDGET_DB, merge_distance=0.0), PRUNED),
    Line("HVQ", "1024 code vectors instead of 8192", Setting("cells-1024", {"quantize": {"cells": 1024}})),
    Line(
        "HVQ",
        "mark in a residual stage too",
        Setting("residual-mark", {"quantize": {"residual_codes": [1024]}, "plan": {"stages": 2}}),
    ),
    Line("HVQ", "compact output: own residuals dropped", compact()),
    Line("uncertainty", "cells weighted evenly", Setting("no-unc-weights", without="uncertainty weights")),
    Line("uncertainty", "no uncertainty in the mask", Setting("no-unc-mask", without="uncertainty mask")),
    Line("uncertainty", "neither", Setting("no-uncertainty", without="uncertainty")),
    Line("frequency", "no texture in the mask", Setting("texture-0", {"plan": {"texture_exponent": 0.0}})),
    Line("frequency", "lambda_freq 0.1, the paper's, instead of 0, compact", compact(0.1), compact()),
    Line("SVD", "RGB axes instead of singular vectors", Setting("no-svd", without="svd")),
    Line("masses", "clipped values move too", Setting("masses-move", {"plan": {"mass_share": 1.0}})),
    Line("balance", "views not balanced", Setting("no-balance", {"plan": {"balance_rounds": 0}})),
    Line("refinement", "60 steps, weights of the text", refined("loss-text", 0.4, 1.0, 0.3)),
    Line("refinement", "60 steps, weights of the appendix", refined("loss-appendix", 0.2, 0.5, 0.05)),
)
QUICK = ("texture-0",)


def lines(quick: bool) -> list[Line]:
    """All, or one."""
    return [line for line in LINES if not quick or line.setting.name in QUICK]


def cells(options: Options) -> list[Cell]:
    """Each line's two settings."""
    wanted = lines(options.quick)
    every = {s.name: s for line in wanted for s in (line.base, line.setting)}
    return setting_cells(options, every.values())


def section(rows: list[Row], options: Options) -> Section:
    """Changes of z, bits, fidelity and seconds, and a verdict in words."""
    table = [
        _line(line, rows) for line in lines(options.quick) if of_kind(rows, setting=line.setting.name, kind="marked")
    ]
    columns = (
        "stage",
        "change",
        *(f"z, {NAMES[c]}" for c in SEEN_AS),
        "bits under attack, before -> after",
        "PSNR, dB",
        "size",
        "embed, s",
        "so",
    )
    return Section(
        "Ablation: what each stage buys",
        [
            "One change at a time. z: change in per cent, paired by scene, key and view, with a bootstrap 95 % "
            "interval over the pairs; the model has one pair a key, of which that is hardly more than the range. "
            "The chips are drawn anew with every change of the plan, which alone moves z of one picture by about "
            "1. PSNR: against the original, worst key view of all scenes and keys. Seconds hold on a machine "
            "that does nothing else.",
            "Changes of pruning are judged by the Gaussians that are left at the same fidelity, not by z: what "
            "prunes less keeps more of the mark. lambda_freq weighs detail over SH coefficients and cannot act "
            "on a scene that has only the first one.",
            INTERVALS,
        ],
        [Table(columns, table)],
        [
            Drawing(
                "ablation",
                lambda: draw(rows, lines(options.quick)),
                "Change of z that each change of the pipeline makes, 95 % intervals; right of 0 the change helps.",
            )
        ],
    )


def _line(line: Line, rows: list[Row]) -> list[Any]:
    new, old = (of_kind(rows, setting=s.name, kind="marked") for s in (line.setting, line.base))
    return [
        line.stage,
        line.change,
        *(str(effect(rows, line.setting.name, line.base.name, c) or "") for c in SEEN_AS),
        f"{_bits(rows, line.base)} -> {_bits(rows, line.setting)}",
        f"{_worst(old):.1f} -> {_worst(new):.1f}",
        f"{100 * _left(rows, line.base):.0f} -> {100 * _left(rows, line.setting):.0f}",
        f"{_seconds(old):.1f} -> {_seconds(new):.1f}",
        verdict(line, rows),
    ]


def verdict(line: Line, rows: list[Row]) -> str:
    """The changes whose interval leaves out 0, and that of the size."""
    found = {c: effect(rows, line.setting.name, line.base.name, c) for c in SEEN_AS}
    if not any(found.values()):
        return "not measured"
    if all(e is not None and e.low == e.high == 0.0 for e in found.values()):
        return "changes nothing here"
    said = [f"{NAMES[c]} {e.percent:+.0f} %" for c, e in found.items() if e is not None and e.is_clear]
    new, old = (_left(rows, setting) for setting in (line.setting, line.base))
    if abs(new / old - 1.0) > 0.005:
        said.append(f"Gaussians {100 * (new / old - 1.0):+.0f} %")
    return "; ".join(said) or "no clear effect"


def draw(rows: list[Row], wanted: list[Line]) -> Figure:
    """A forest: one row a change, one mark a kind of evidence."""
    shown = [line for line in wanted if of_kind(rows, setting=line.setting.name, kind="marked")]
    drawn, axes = figure(width=8.6, height=1.2 + 0.42 * max(len(shown), 1))
    for slot, (condition, style) in enumerate(zip(SEEN_AS, styles(), strict=False)):
        points = []
        for number, line in enumerate(shown):
            found = effect(rows, line.setting.name, line.base.name, condition)
            if found is not None:
                points.append(
                    (found.percent, number - 0.24 + 0.16 * slot, found.percent - found.low, found.high - found.percent)
                )
        if points:
            x, y, below, above = zip(*points, strict=True)
            look = {**style, "linestyle": "none", "markersize": 4.5}
            axes.errorbar(x, y, xerr=[below, above], capsize=1.5, label=NAMES[condition], **look)
    axes.axvline(0.0, color="#1a1a1a", linewidth=0.8)
    axes.set_yticks(range(len(shown)), [f"{line.stage}: {line.change}" for line in shown])
    axes.invert_yaxis()
    axes.set_xlabel("change of z, %")
    axes.set_title("What each change does to the claim")
    drawn.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return drawn


def _bits(rows: list[Row], setting: Setting) -> str:
    of = of_kind(rows, setting=setting.name, kind="picture")
    found = accuracy([row for row in of if row["attack"] != "none"])
    return "" if found is None else f"{100 * found.share:.1f} % ({100 * found.low:.1f} to {100 * found.high:.1f})"


def _worst(rows: list[Row]) -> float:
    return float(min(row["psnr_total_worst_view"] for row in rows))


def _seconds(rows: list[Row]) -> float:
    return float(sum(row["embed_seconds"] for row in rows) / len(rows))


def _left(rows: list[Row], setting: Setting) -> float:
    """Mean share of the Gaussians that are delivered."""
    of = of_kind(rows, setting=setting.name, kind="marked")
    return float(sum(row["gaussians_out"] / row["gaussians_in"] for row in of) / len(of))


PART = Part("ablation", "Ablation", "What does each stage of the pipeline buy, and what buys nothing?", cells, section)
