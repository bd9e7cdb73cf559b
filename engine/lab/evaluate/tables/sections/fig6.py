"""Figure 6: bits over the hyper-parameters, the paper's and ours."""

from statistics import fmean

from engine.lab.evaluate.figures import Figure, figure
from engine.lab.evaluate.study import Cell, Drawing, Options, Row, Section, Table
from engine.lab.evaluate.summary import INTERVALS, grouped, picked
from engine.lab.evaluate.tables import stopping
from engine.lab.evaluate.tables.part import DEFAULT, Part, Setting, printed, setting_cells
from engine.lab.evaluate.tables.sections.table6 import LOSSES, refined
from engine.lab.evaluate.tables.tables_curves import Knob, draw_knob, knob_table

DOUBTS, PAPER_STEPS = (0.8, 1.0, 1.1, 1.2, 1.4, 1.6), 100
"""tau_unc of the paper's figure, and the Adam steps of these points."""
WEIGHTS = dict(zip(("lambda_msg", "lambda_rec", "lambda_wavelet"), LOSSES["loss-text"], strict=True))
TEXT = refined("loss-text", *WEIGHTS.values())
NO_COUNTERPART = (
    ("tau_unc", "none: displacement falls continuously with certainty; in profile `paper`, as the paper has it"),
    ("tau_occ", "none: transmittance alone ends a pixel; as an option of the renderer, as Eq 8 says"),
    ("lambda_freq", "weight of detail in the residual codebooks of the compact output; 0 in every profile"),
    ("lambda_msg, lambda_rec, lambda_wavelet", "the same, in a refinement that no profile uses"),
)


def compact(lambda_freq: float = 0.0) -> Setting:
    """Codebooks alone, learnt with this weight of detail."""
    return Setting(f"freq-{lambda_freq:g}", {"output": "compact", "quantize": {"lambda_freq": lambda_freq}})


def knobs(quick: bool) -> list[Knob]:
    """All panels but that of tau_occ: five of the paper's, three of ours."""
    best = {row["knob"]: row["best"] for row in printed("figure6")}
    if quick:
        return [Knob("texture exponent", {v: _texture(v) for v in (0.0, 0.5)}, 0.5)]
    losses = {
        "lambda_msg": (0.1, 0.2, 0.4, 0.8),
        "lambda_rec": (0.25, 0.5, 1.0, 2.0),
        "lambda_wavelet": (0.05, 0.3, 1.0),
    }
    return [
        Knob("tau_unc, deviations (profile paper)", {v: _doubt(v) for v in DOUBTS}, -1.0, best["tau_unc"]),
        *(
            Knob(name, {v: _loss(name, v) for v in values}, WEIGHTS[name], best[name], log=True)
            for name, values in losses.items()
        ),
        Knob("lambda_freq (compact output)", {v: compact(v) for v in (0.0, 0.1, 0.5, 2.0)}, 0.0, best["lambda_freq"]),
        Knob("texture exponent", {v: _texture(v) for v in (0.0, 0.25, 0.5, 1.0)}, 0.5),
        Knob("code vectors", {v: _codes_of(v) for v in (1024, 2048, 4096, 8192)}, 4096, log=True),
        Knob("key views", {v: _views(v) for v in (2, 4, 6, 10, 16)}, 6, log=True),
    ]


def _doubt(value: float) -> Setting:
    """The paper's system with this threshold of uncertainty."""
    steps = {"refine": {"steps": PAPER_STEPS}}
    return Setting(f"doubt-{value:g}", {"paper": {"tau_unc": value}, **steps}, profile="paper")


def _loss(name: str, value: float) -> Setting:
    if value == WEIGHTS[name]:
        return TEXT
    return refined(f"{name.removeprefix('lambda_')}-{value:g}", *(WEIGHTS | {name: value}).values())


def _texture(value: float) -> Setting:
    return DEFAULT if value == 0.5 else Setting(f"texture-{value:g}", {"plan": {"texture_exponent": value}})


def _codes_of(count: int) -> Setting:
    return DEFAULT if count == 4096 else Setting(f"codes-{count}", {"plan": {"codes": count}})


def _views(count: int) -> Setting:
    return DEFAULT if count == 6 else Setting(f"views-{count}", {"views": count})


def cells(options: Options) -> list[Cell]:
    """Every point of every panel."""
    points = [setting for knob in knobs(options.quick) for setting in knob.points.values()]
    return [*setting_cells(options, points), *stopping.cells(options)]


def section(rows: list[Row], options: Options) -> Section:
    """One panel a knob."""
    panels = knobs(options.quick)
    return Section(
        "Figure 6: hyper-parameters",
        [
            "The paper plots bit accuracy over six hyper-parameters and prints only where it peaks. Here bits "
            "saturate, so the curves show z of one picture: an error of a bit becomes likely only when z falls "
            "below about 12 at 32 bits. The peaks of the paper's figure are marked where the knob exists.",
            "tau_occ: Eq 8 sums opacities without the transmittance before them, so its 1.2 does end pixels. It is "
            "a rule of drawing: the picture is drawn by it and read as any other.",
            INTERVALS,
        ],
        [
            Table(("the paper's knob", "in our profiles"), NO_COUNTERPART),
            stopping.stops_table(rows),
            knob_table(panels, rows),
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
    count = len(panels) + 1
    across = min(4, count)
    down = -(-count // across)
    drawn, grid = figure(down, across, width=2.5 * across + 0.6, height=2.5 * down + 0.7, squeeze=False, sharey=True)
    every = list(grid.flat)
    for axes, knob in zip(every, panels, strict=False):
        draw_knob(axes, knob, rows)
    stopping.draw_stops(every[len(panels)], rows)
    for axes in every[count:]:
        axes.set_axis_off()
    for first in grid[:, 0]:
        first.set_ylabel("z of one picture")
    drawn.suptitle(_finding(rows, panels), x=0.01, ha="left", fontweight="bold", fontsize=10)
    drawn.legend(*every[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return drawn


def _finding(rows: list[Row], panels: list[Knob]) -> str:
    """How much the weakest kind of picture moves over all panels."""
    names = {setting.name for knob in panels for setting in knob.points.values()}
    z = grouped([row for row in picked(rows, attack="JPEG 10") if row.get("setting") in names], "setting")
    if len(z) < 2:
        return "Hyper-parameters"
    means = [fmean(row["z"] for row in own) for own in z.values()]
    return f"Over all these settings, z after JPEG 10 stays between {min(means):.0f} and {max(means):.0f}"


PART = Part("fig6", "Figure 6: hyper-parameters", "Which hyper-parameters matter, and how much?", cells, section)
