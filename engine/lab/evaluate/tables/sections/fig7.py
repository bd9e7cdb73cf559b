"""Figure 7: bits and quality over pruning and over the strength of the mark."""

from statistics import fmean

from engine.lab.evaluate.figures import Axes, Figure, figure, label_line, styles
from engine.lab.evaluate.study import Cell, Drawing, Options, Row, Section
from engine.lab.evaluate.summary import INTERVALS, picked, table
from engine.lab.evaluate.tables.part import DEFAULT, Part, Setting, setting_cells
from engine.lab.evaluate.tables.tables_curves import Knob, draw_knob, knob_table

BUDGET_DB = 30.0
"""Budget at which gamma is turned, dB."""


GAMMAS: tuple[float, ...] = (0.0, 0.1, 0.2, 0.3, 0.5)


def strength(db: float) -> Setting:
    """The mark at this PSNR; SSIM does not limit it."""
    return Setting(f"psnr-{db:g}", {"psnr_db": db, "ssim": 0.0})


def pruned(budget: float, gamma: float | None = None, **more: float | str) -> Setting:
    """Pruned to a budget, dB; the profile's own gamma where none is given."""
    knobs = {"budget_db": budget, **({} if gamma is None else {"gamma": gamma}), **more}
    return Setting("-".join(["prune", *(f"{k}-{v}" for k, v in knobs.items())]), {"prune": knobs})


def knobs(quick: bool) -> dict[str, Knob]:
    """Budget, gamma, strength."""
    budgets: tuple[float, ...] = (45.0, 40.0, 35.0, 30.0, 25.0)
    gammas = GAMMAS
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
    points = [setting for knob in knobs(options.quick).values() for setting in knob.points.values()]
    return setting_cells(options, [DEFAULT, *points])


def section(rows: list[Row], options: Options) -> Section:
    """What pruning and strength do to bits and look."""
    panels = knobs(options.quick)
    shares = table(
        [
            {"knob": knob.name, "value": value, "of": of}
            for knob in (panels["budget"], panels["gamma"])
            for value, of in _marked(rows, knob).items()
        ],
        "knob",
        "value",
        ("pruned, %", lambda line: f"{share_pruned(line['of']):.1f}"),
        (
            "worst key view against the original, dB",
            lambda line: min(row["psnr_total_worst_view"] for row in line["of"]),
        ),
        title="What pruning removes",
    )
    return Section(
        "Figure 7: pruning and strength",
        [
            "The paper prunes by a fixed aggressiveness (gamma 0.2: 60 to 70 % of the model; above 0.3 over 80 "
            "%, and bits fall) and scales the mark by zeta (0.6 best). Here pruning stops at the owner's budget "
            "in dB whatever gamma is, which then only says how evenly it is spread; zeta's place is taken by the "
            "fidelity the owner requires. A picture's z is against its own pruned reference.",
            INTERVALS,
        ],
        [knob_table(panels.values(), rows), shares],
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
    pruned_ = {value: share_pruned(of) for value, of in _marked(rows, budget).items()}
    with_share = Knob("Gaussians removed, %", {0.0: DEFAULT, **{v: budget.points[v] for v in pruned_}}, -1.0)
    whole = picked(rows, setting=DEFAULT.name, kind="marked")
    draw_knob(axes[0], with_share, rows, [share_pruned(whole) if whole else 0.0, *pruned_.values()])
    for value, place in pruned_.items():
        look = {"textcoords": "offset points", "ha": "center", "fontsize": 7, "color": "#6a6a6a"}
        axes[0].annotate(f"{value:g} dB", (place, 0), xytext=(0, 3), **look)
    axes[0].set_title("Pruning to a budget")
    _draw_gamma(axes[1], panels["gamma"], rows)
    draw_knob(axes[2], panels["strength"], rows)
    axes[2].set_title("Strength of the mark")
    axes[2].invert_xaxis()
    axes[0].set_ylabel("z of one picture")
    drawn.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return drawn


def _draw_gamma(axes: Axes, knob: Knob, rows: list[Row]) -> None:
    """Share removed at the same budget over gamma."""
    shares = {value: share_pruned(of) for value, of in _marked(rows, knob).items()}
    axes.plot(list(shares), list(shares.values()), **{**next(styles()), "color": "#1a1a1a"})
    moved = max(shares.values(), default=0.0) - min(shares.values(), default=0.0)
    title = f"Gamma moves {moved:.1f} points" if len(shares) > 1 else "Gamma at a budget"
    axes.set(ylim=(0, 100), xlabel=knob.name, ylabel="Gaussians removed, %", title=title)
    if shares:
        label_line(axes, knob.ours, "ours", along="y")
        label_line(axes, 0.2, "the paper's", along="y")


def _marked(rows: list[Row], knob: Knob) -> dict[float, list[Row]]:
    """Markings at each point that has any."""
    found = {value: picked(rows, setting=setting.name, kind="marked") for value, setting in knob.points.items()}
    return {value: of for value, of in found.items() if of}


def share_pruned(marked: list[Row]) -> float:
    """Mean over keys and scenes of the share of Gaussians removed, per cent."""
    return 100.0 * fmean(1.0 - row["gaussians_out"] / row["gaussians_in"] for row in marked)


PART = Part(
    "fig7",
    "Figure 7: pruning and strength",
    "How much may be pruned, how faint may the mark be, before bits are lost?",
    cells,
    section,
)
