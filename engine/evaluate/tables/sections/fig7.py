"""Figure 7: bits and quality over pruning and over the strength of the mark."""

from __future__ import annotations

from typing import TYPE_CHECKING

from engine.evaluate.drawing import figure, label_line, styles
from engine.evaluate.study import Cell, Drawing, Options, Row, Section, Table
from engine.evaluate.tables.knob import COLUMNS, Knob, draw_knob, knob_rows
from engine.evaluate.tables.part import Part, of_kind, setting_cells
from engine.evaluate.tables.setting import DEFAULT, Setting
from engine.evaluate.tables.words import INTERVALS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BUDGET_DB = 30.0
"""Budget at which gamma is turned, dB."""


def strength(db: float) -> Setting:
    """The mark at this PSNR; SSIM does not limit it."""
    return Setting(f"psnr-{db:g}", {"psnr_db": db, "ssim": 0.0})


def pruned(budget: float, gamma: float | None = None, **more: object) -> Setting:
    """Pruned to a budget, dB; the profile's own gamma where none is given."""
    knobs = {"budget_db": budget, **({} if gamma is None else {"gamma": gamma}), **more}
    return Setting("-".join(["prune", *(f"{k}-{v}" for k, v in knobs.items())]), {"prune": knobs})


def knobs(quick: bool) -> dict[str, Knob]:
    """Budget, gamma, strength."""
    budgets: tuple[float, ...] = (45.0, 40.0, 35.0, 30.0, 25.0)
    gammas: tuple[float, ...] = (0.0, 0.1, 0.2, 0.3, 0.5)
    levels: tuple[float, ...] = (60.0, 55.0, 50.0, 47.0, 42.0, 37.0, 32.0)
    if quick:
        budgets, gammas, levels = (30.0,), (), (40.0,)
    return {
        "budget": Knob("pruning budget, dB", {v: pruned(v) for v in budgets}, 0.0),
        "gamma": Knob(
            f"gamma (at {BUDGET_DB:g} dB)",
            {v: pruned(BUDGET_DB) if v == 0.0 else pruned(BUDGET_DB, v) for v in gammas},
            0.0,
            0.2,
        ),
        "strength": Knob("PSNR of the mark, dB", {v: strength(v) for v in levels}, 47.0),
    }


def cells(options: Options) -> list[Cell]:
    """Every point, and the model without pruning."""
    every = {setting.name: setting for knob in knobs(options.quick).values() for setting in knob.points.values()}
    return setting_cells(options, [DEFAULT, *every.values()])


def section(rows: list[Row], options: Options) -> Section:
    """What pruning and strength do to bits and look."""
    panels = knobs(options.quick)
    shares = [
        [knob.name, value, f"{100 * _share_pruned(rows, setting.name):.1f}", _least(rows, setting.name)]
        for knob in (panels["budget"], panels["gamma"])
        for value, setting in knob.points.items()
        if of_kind(rows, setting=setting.name, kind="marked")
    ]
    return Section(
        "Figure 7: pruning and strength",
        [
            "The paper prunes by a fixed aggressiveness (gamma 0.2: 60 to 70 % of the model; above 0.3 over 80 "
            "%, and bits fall) and scales the mark by zeta (0.6 best). Here pruning stops at the owner's budget "
            "in dB whatever gamma is, which then only says how evenly it is spread; zeta's place is taken by the "
            "fidelity the owner asks for. A picture's z is against its own pruned reference.",
            INTERVALS,
        ],
        [
            Table(COLUMNS, [line for knob in panels.values() for line in knob_rows(knob, rows)], "Every point"),
            Table(
                ("knob", "value", "pruned, %", "worst key view against the original, dB"),
                shares,
                "What pruning removes",
            ),
        ],
        [
            Drawing(
                "fig7",
                lambda: draw(rows, panels),
                "Left: share of Gaussians removed and what is left of the claim, without attack and after JPEG "
                "10 and noise. Right: the same over the strength of the mark. Bootstrap 95 % over views and keys.",
            )
        ],
    )


def draw(rows: list[Row], panels: dict[str, Knob]) -> Figure:
    """Pruned share, gamma, strength."""
    drawn, axes = figure(1, 3, width=10.2, height=3.8)
    budget = panels["budget"]
    with_share = Knob(
        "Gaussians removed, %",
        {0.0: DEFAULT, **{v: s for v, s in budget.points.items() if of_kind(rows, setting=s.name, kind="marked")}},
        -1.0,
    )
    places = [100 * _share_pruned(rows, setting.name) for setting in with_share.points.values()]
    draw_knob(axes[0], with_share, rows, places)
    for value, place in list(zip(with_share.points, places, strict=True))[1:]:
        axes[0].annotate(
            f"{value:g} dB",
            (place, 0),
            xytext=(0, 3),
            textcoords="offset points",
            ha="center",
            fontsize=7,
            color="#6a6a6a",
        )
    axes[0].set_title("Pruning to a budget")
    _draw_gamma(axes[1], panels["gamma"], rows)
    draw_knob(axes[2], panels["strength"], rows)
    axes[2].set_title("Strength of the mark")
    axes[2].invert_xaxis()
    axes[0].set_ylabel("z of one picture")
    handles = axes[0].get_legend_handles_labels()
    drawn.legend(*handles, loc="outside lower center", ncols=3)
    return drawn


def _draw_gamma(axes: Axes, knob: Knob, rows: list[Row]) -> None:
    """Share removed at the same budget over gamma."""
    style = next(styles())
    values = [v for v, s in knob.points.items() if of_kind(rows, setting=s.name, kind="marked")]
    axes.plot(values, [100 * _share_pruned(rows, knob.points[v].name) for v in values], **{**style, "color": "#1a1a1a"})
    axes.set_ylim(0, 100)
    axes.set_xlabel(knob.name)
    axes.set_ylabel("Gaussians removed, %")
    axes.set_title(_gamma_finding(rows, knob))
    if values:
        label_line(axes, knob.ours, "ours", along="y")
        label_line(axes, 0.2, "the paper's", along="y")


def _gamma_finding(rows: list[Row], knob: Knob) -> str:
    shares = [
        100 * _share_pruned(rows, setting.name)
        for setting in knob.points.values()
        if of_kind(rows, setting=setting.name, kind="marked")
    ]
    return f"Gamma moves {max(shares) - min(shares):.1f} points" if len(shares) > 1 else "Gamma at a budget"


def _share_pruned(rows: list[Row], setting: str) -> float:
    """Mean over keys and scenes of the share of Gaussians removed."""
    of = of_kind(rows, setting=setting, kind="marked")
    return float(sum(1.0 - row["gaussians_out"] / row["gaussians_in"] for row in of) / max(len(of), 1))


def _least(rows: list[Row], setting: str) -> float:
    return float(min(row["psnr_total_worst_view"] for row in of_kind(rows, setting=setting, kind="marked")))


PART = Part(
    "fig7",
    "Figure 7: pruning and strength",
    "How much may be pruned, how faint may the mark be, before bits are lost?",
    cells,
    section,
)
