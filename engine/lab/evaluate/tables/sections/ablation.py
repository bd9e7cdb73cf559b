"""Ablation: each stage of the pipeline against the pipeline with it."""

from dataclasses import dataclass
from statistics import fmean

from engine.lab.evaluate.figures import INK, Figure, figure, styles
from engine.lab.evaluate.study import Cell, Drawing, Options, Row, Section
from engine.lab.evaluate.summary import INTERVALS, accuracy, share_text, table
from engine.lab.evaluate.tables.part import CONDITIONS, DEFAULT, Part, Setting, rows_of_setting, setting_cells
from engine.lab.evaluate.tables.sections.fig6 import compact
from engine.lab.evaluate.tables.sections.fig7 import BUDGET_DB, pruned, share_pruned
from engine.lab.evaluate.tables.sections.table6 import LOSSES, STEPS, refined
from engine.lab.evaluate.tables.tables_curves import Effect, effect

NAMES = {"model": "the model", "none": "picture", **{name: f"picture, {name}" for name in CONDITIONS[1:]}}
"""What z is read from."""


@dataclass(frozen=True)
class Line:
    """One stage, what is done to it, the setting with that change and the one without."""

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
    Line("HVQ", "1024 code vectors instead of 4096", Setting("codes-1024", {"plan": {"codes": 1024}})),
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
    Line("refinement", f"{STEPS} steps, weights of the text", refined("loss-text", *LOSSES["loss-text"])),
    Line("refinement", f"{STEPS} steps, weights of the appendix", refined("loss-appendix", *LOSSES["loss-appendix"])),
)
QUICK = ("texture-0",)


def lines(quick: bool) -> list[Line]:
    """All, or one."""
    return [line for line in LINES if not quick or line.setting.name in QUICK]


def cells(options: Options) -> list[Cell]:
    """Each line's two settings."""
    return setting_cells(options, [setting for line in lines(options.quick) for setting in (line.base, line.setting)])


def section(rows: list[Row], options: Options) -> Section:
    """Changes of z, bits, fidelity and seconds, and a verdict in words."""
    compared = table(
        [
            {
                "stage": line.stage,
                "change": line.change,
                **{f"z, {NAMES[seen]}": str(found or "") for seen, found in _effects(line, rows).items()},
                **_sides(line, rows),
                "so": verdict(line, rows),
            }
            for line in _shown(lines(options.quick), rows)
        ],
        "stage",
        "change",
        *(f"z, {name}" for name in NAMES.values()),
        ("bits under attack, before -> after", lambda of: f"{_bits(of['before'])} -> {_bits(of['after'])}"),
        ("PSNR, dB", lambda of: f"{_worst(of['before']):.1f} -> {_worst(of['after']):.1f}"),
        ("size", lambda of: f"{_left(of['before']):.0f} -> {_left(of['after']):.0f}"),
        ("embed, s", lambda of: f"{_seconds(of['before']):.1f} -> {_seconds(of['after']):.1f}"),
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
        [compared],
        [
            Drawing(
                "ablation",
                lambda: draw(rows, lines(options.quick)),
                "Change of z that each change of the pipeline makes, 95 % intervals; right of 0 the change helps.",
            )
        ],
    )


def _effects(line: Line, rows: list[Row]) -> dict[str, Effect | None]:
    return {seen: effect(rows, line.setting.name, line.base.name, seen) for seen in NAMES}


def _sides(line: Line, rows: list[Row]) -> dict[str, dict[str, list[Row]]]:
    sides = {"before": line.base, "after": line.setting}
    return {side: rows_of_setting(rows, setting.name) for side, setting in sides.items()}


def _shown(wanted: list[Line], rows: list[Row]) -> list[Line]:
    return [line for line in wanted if _sides(line, rows)["after"]["marked"]]


def verdict(line: Line, rows: list[Row]) -> str:
    """The changes whose interval leaves out 0, and that of the size."""
    found, sides = _effects(line, rows), _sides(line, rows)
    if not any(found.values()):
        return "not measured"
    if all(e is not None and e.low == e.high == 0.0 for e in found.values()):
        return "changes nothing here"
    said = [f"{NAMES[c]} {e.percent:+.0f} %" for c, e in found.items() if e is not None and e.is_clear]
    size = 100 * (_left(sides["after"]) / _left(sides["before"]) - 1.0)
    if abs(size) > 0.5:
        said.append(f"Gaussians {size:+.0f} %")
    return "; ".join(said) or "no clear effect"


def draw(rows: list[Row], wanted: list[Line]) -> Figure:
    """A forest: one row a change, one mark a kind of evidence."""
    shown = _shown(wanted, rows)
    drawn, axes = figure(width=8.6, height=1.2 + 0.42 * max(len(shown), 1))
    for slot, (condition, style) in enumerate(zip(NAMES, styles(), strict=False)):
        points = [
            (e.percent, number - 0.24 + 0.16 * slot, e.percent - e.low, e.high - e.percent)
            for number, line in enumerate(shown)
            if (e := effect(rows, line.setting.name, line.base.name, condition)) is not None
        ]
        if points:
            x, y, below, above = zip(*points, strict=True)
            look = {**style, "linestyle": "none", "markersize": 4.5}
            axes.errorbar(x, y, xerr=[below, above], capsize=1.5, label=NAMES[condition], **look)
    axes.axvline(0.0, color=INK, linewidth=0.8)
    axes.set_yticks(range(len(shown)), [f"{line.stage}: {line.change}" for line in shown])
    axes.invert_yaxis()
    axes.set(xlabel="change of z, %", title="What each change does to the claim")
    drawn.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return drawn


def _bits(of: dict[str, list[Row]]) -> str:
    return share_text(accuracy([row for row in of["picture"] if row["attack"] != "none"]))


def _worst(of: dict[str, list[Row]]) -> float:
    return float(min(row["psnr_total_worst_view"] for row in of["marked"]))


def _seconds(of: dict[str, list[Row]]) -> float:
    return fmean(row["embed_seconds"] for row in of["marked"])


def _left(of: dict[str, list[Row]]) -> float:
    """Mean share of the Gaussians that are delivered, per cent."""
    return 100.0 - share_pruned(of["marked"])


PART = Part("ablation", "Ablation", "What does each stage of the pipeline buy, and what buys nothing?", cells, section)
