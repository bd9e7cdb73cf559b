"""Suite 5 (the paper's Figure 5): can it be seen, without the key, that there is a mark?

Full, on 2 cores and a scene of 100k Gaussians: 2 keys x 100 renders about 2 minutes; the learned detector, 4 + 4 keys,
about 1 minute for each of the three forms and two baselines. With several scenes a stranger is tried as well. Quick:
24 renders, one key and one form, about half a minute.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from engine.errors import InputError
from engine.lab.evaluate.figures import FAINT, Figure, figure, label_line, styles
from engine.lab.evaluate.intervals import area, area_interval
from engine.lab.evaluate.steganalysis.copy_differences import SECRETS, compare_copies
from engine.lab.evaluate.steganalysis.learned_detectors import FORMS, detect_as_insider, detect_as_stranger
from engine.lab.evaluate.steganalysis.picture_detectors import DETECTORS, look_at_renders
from engine.lab.evaluate.study import Bar, Cell, Drawing, Options, Report, Row, Section, Study, Table
from engine.lab.evaluate.summary import distinct, grouped, picked, table
from engine.model import Float64

__all__ = ["STUDY"]

PARTS = ("renders", "insider", "differences", "stranger")
BASELINES = ("qim", "spread")
PROFILE = "fast"
HALF_WIDTH = 0.02
"""The bar: AUC within 0.5 +- 0.02."""
CHANCE = f"0.5 +- {HALF_WIDTH}"
THRESHOLDS = (0.001, 0.003, 0.01, 0.02, 0.03, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 0.95)
"""The range of the paper's Figure 5; 0.2 is StegExpose's own."""
RECOVERED = 0.05
"""How far the mean estimate of the rate may lie from the truth for the detectors to count as right."""
RATE_DETECTORS = tuple(name for name in DETECTORS if name != "chi-square")
"""Chi-square sees full or sequential embedding, not a rate."""


def cells(options: Options) -> list[Cell]:
    """Renders of each scene and key; insiders of each scene and form; differences of copies; strangers over all scenes.
    `options.settings` chooses among these PARTS; InputError where it names another."""
    if unknown := [name for name in options.settings if name not in PARTS]:
        raise InputError(f"there is no part {unknown[0]!r}; there are {', '.join(PARTS)}")
    seeds, views, checked, size, keys = (1, 24, 3, 256, 1) if options.quick else (2, 100, 10, 512, 4)
    forms, methods = (FORMS[:1], ()) if options.quick else (FORMS, BASELINES)
    common = {"profile_name": PROFILE, "seed": options.seed}
    looks = {"views": views, "checked_views": checked, "size": size}
    made = []
    for number, path in enumerate(options.scenes):
        for seed in range(options.seed, options.seed + seeds):
            arguments = {**common, **looks, "path": path, "seed": seed}
            made.append(Cell.of(f"renders-{number}-{seed}", look_at_renders, **arguments))
        for method, form in [*(("ours", form) for form in forms), *((method, FORMS[0]) for method in methods)]:
            name = f"insider-{number}-{method}-{form.replace(' ', '-')}"
            made.append(Cell.of(name, detect_as_insider, **common, path=path, keys=keys, form=form, method=method))
        name, arguments = (
            f"differences-{number}",
            {**common, "path": path, "form": "floats", "pairs": 1 if options.quick else 2},
        )
        made.append(Cell.of(name, compare_copies, **arguments))
    for form in forms if len(options.scenes) > 1 else ():
        arguments = {**common, "paths": list(options.scenes), "form": form, "keys": max(1, keys // 2)}
        made.append(Cell.of(f"stranger-{form.replace(' ', '-')}", detect_as_stranger, **arguments))
    return [cell for cell in made if cell.name.split("-")[0] in (options.settings or PARTS)]


def report(rows: list[Row], options: Options) -> Report:
    """Bars on both kinds of detector; figures and tables below them."""
    pictures = [row for row in rows if "fusion" in row]
    learned = [row for row in rows if "auc" in row]
    areas = [_compared(pictures, name) for name in (*DETECTORS, "fusion")] if pictures else []
    compared = [row for row in rows if "difference_auc" in row]
    bars = [_fusion_bar(areas[-1]), *_check_bars(pictures)] if pictures else []
    bars += [*_learned_bars(learned), *_difference_bars(compared)]
    seen = [f"{bar.what}: {bar.measured}" for bar in bars if bar.met is False]
    answer = "Not everything stays at chance: " + "; ".join(seen) + "."
    return Report(
        bars,
        [
            *([_pictures_section(pictures, areas), _check_section(pictures)] if pictures else []),
            *([_learned_section(learned)] if learned else []),
            _difference_section(compared),
        ],
        answer=[answer if seen else "Every detector that was tried stays at chance."],
        summary={"auc": {found["name"]: {field: found[field] for field in ("auc", "low", "high")} for found in areas}},
    )


def _scores(rows: Sequence[Row], name: str, **of: object) -> Float64:
    return np.array([row[name] for row in picked(rows, **of)])


def _compared(rows: Sequence[Row], name: str) -> Row:
    """A detector's AUC on marked against unmarked views, with its interval over views."""
    unmarked, marked = _scores(rows, name, kind="unmarked"), _scores(rows, name, kind="marked")
    low, high = area_interval([(unmarked[k : k + 1], marked[k : k + 1]) for k in range(len(unmarked))])
    return {"name": name, "auc": area(unmarked, marked), "low": low, "high": high, "views": len(marked)}


def _fusion_bar(fusion: Row) -> Bar:
    measured = "{auc:.4f} (95 % {low:.4f} to {high:.4f}, {views} views)".format_map(fusion)
    promise = "StegExpose's fusion on renders: AUC, marked against unmarked"
    return Bar(promise, CHANCE, measured, abs(fusion["auc"] - 0.5) <= HALF_WIDTH)


def _check_bars(rows: Sequence[Row]) -> list[Bar]:
    checked = grouped(sorted(picked(rows, kind="lsb"), key=lambda row: row["rate"]), "rate")
    worst, where = 0.0, ""
    for name in RATE_DETECTORS:
        for rate, own in checked.items():
            mean = float(np.mean(_scores(own, name)))
            if abs(mean - rate) >= worst:
                worst, where = abs(mean - rate), f"{name} reads {mean:.3f} where {rate:g} was embedded"
    full = _scores(rows, "fusion", kind="lsb", rate=max(checked))
    found = area(_scores(rows, "fusion", kind="unmarked"), full)
    return [
        Bar(
            "Detectors check: error of the mean rate on LSB-embedded renders",
            f"<= {RECOVERED}",
            f"{worst:.3f} ({where})",
            worst <= RECOVERED,
        ),
        Bar(
            "Detectors check: AUC of the fusion on fully LSB-embedded renders",
            ">= 0.99",
            f"{found:.4f} ({len(full)} pictures)",
            found >= 0.99,
        ),
    ]


def _learned_bars(rows: Sequence[Row]) -> list[Bar]:
    bars = []
    for attacker in distinct(picked(rows, method="ours"), "attacker"):
        for form in ("floats", "own format"):
            own = picked(rows, method="ours", attacker=attacker, form=form)
            own = own if attacker == "insider" else picked(own, scene="all")
            if not own:
                continue
            worst = max(own, key=_off)
            measured = "{auc:.3f} (95 % {low:.3f} to {high:.3f}; {classifier}, {scene})".format_map(worst)
            promise = f"Learned detector on attributes, {attacker}, {form}: AUC of a region, worst case"
            bars.append(Bar(promise, CHANCE, measured, _off(worst) <= HALF_WIDTH))
    if rows and not picked(rows, attacker="stranger"):
        promise = "Learned detector on attributes, stranger: AUC of a region"
        bars.append(Bar(promise, CHANCE, "needs at least two scenes", None))
    return bars


def _difference_bars(rows: Sequence[Row]) -> list[Bar]:
    """One-sided: what was learnt in one half of a scene and misleads in the other tells a thief nothing."""
    bars = []
    for secret in SECRETS:
        own = picked(rows, secret=secret)
        if not own:
            continue
        worst = max(own, key=lambda row: float(row["difference_auc"]))
        measured = "{difference_auc:.4f} ({scene})".format_map(worst)
        promise = f"Differences of two copies: AUC of the owner's {secret}, worst scene"
        bars.append(Bar(promise, f"<= {0.5 + HALF_WIDTH}", measured, worst["difference_auc"] <= 0.5 + HALF_WIDTH))
    return bars


def _difference_section(rows: Sequence[Row]) -> Section:
    text = (
        "Two copies of one asset differ in the layer that tells recipients apart. A classifier that knows the owner's "
        "secrets on half of the Gaussians is asked for those of the other half; the check asks for the signs of the "
        "first copy's own layer, which the difference does tell. Borders are asked for where the owner's cells "
        "and another key's disagree: those of public cells are in both."
    )
    columns = {
        "asked for": "secret",
        "form": "form",
        "scene": "scene",
        "AUC": "{difference_auc:.4f}",
        "cases": "{cases:,}",
    }
    return Section("Differences of two copies", [text], [table(rows, *columns.items())], [])


def _off(row: Row) -> float:
    return abs(float(row["auc"]) - 0.5)


def _pictures_section(rows: Sequence[Row], areas: Sequence[Row]) -> Section:
    unmarked, marked = _scores(rows, "fusion", kind="unmarked"), _scores(rows, "fusion", kind="marked")
    lines = [
        [f"{t:g}", f"{100 * (unmarked >= t).mean():.1f} %", f"{100 * (marked >= t).mean():.1f} %"] for t in THRESHOLDS
    ]
    columns = {"detector": "name", "AUC": "{auc:.4f}", "95 %": "{low:.4f} to {high:.4f}"}
    title = f"On renders, StegExpose's fusion has an AUC of {areas[-1]['auc']:.3f}"
    caption = "ROC of the fusion on renders; pictures with replaced bits show what it can see."
    return Section(
        "On renders",
        [
            "The same views, unmarked and marked, as 8-bit pictures. Primary sets, chi-square, sample pairs and RS "
            "analysis, averaged as StegExpose does; own code. They look for replaced least significant bits, and our "
            "mark replaces none: it changes the scene before it is rounded. Staying at chance here says that these "
            "classic tools see nothing, not that nothing can. Intervals resample views."
        ],
        [
            table(areas, *columns.items(), title="Marked against unmarked"),
            Table(["threshold", "unmarked called marked", "marked called marked"], lines, "Fusion by threshold"),
        ],
        [Drawing("roc", partial(draw_roc, rows, title), caption)],
    )


def _check_section(rows: Sequence[Row]) -> Section:
    drawing = Drawing(
        "check",
        partial(draw_check, rows, "The detectors recover the true embedding rate"),
        "Chi-square answers to full embedding only, as its authors say.",
    )
    text = "Unmarked renders, least significant bits replaced at random in a known share of all places."
    return Section("Are the detectors right?", [text], drawings=[drawing])


def _learned_section(rows: Sequence[Row]) -> Section:
    shown = table(
        rows,
        "method",
        "attacker",
        "form",
        "scene",
        "classifier",
        ("AUC of a region", "{auc:.3f}"),
        ("95 %", "{low:.3f} to {high:.3f}"),
        ("shift of the mean score (std of regions)", "{shift:+.2f}"),
        "regions",
    )
    worst = max((row for row in picked(rows, method="ours") if row["form"] != "lattice lost"), key=_off)
    title = "Learned detectors on attributes stay at chance"
    if _off(worst) > HALF_WIDTH:
        title = f"A learned detector sees the mark in the model's numbers: AUC up to {worst['auc']:.2f}"
    caption = "AUC of learned detectors on regions of the model, with 95 % intervals; 0.5 is a coin."
    return Section(
        "On the model's own numbers",
        [
            "A classifier sees how the DC colours of a region of about 512 Gaussians differ from their neighbours' at "
            "three sizes, how they are distributed, and how often a value repeats; never a key. The insider has the "
            "unmarked model and marked copies of this very scene under other keys, and is tested on other regions "
            "under new keys; the stranger knows other scenes only.",
            "Forms: 'floats' is a model trained and delivered in floating point (files of few values are spread over "
            "their cells first); 'own format' is marked and delivered in the format it came in; 'lattice lost' is a "
            "file of few values delivered in floats, where the missing lattice alone gives the change away: a model "
            "that came as .splat or .sog should be delivered so.",
            "The shift says what many regions add up to: a mean over n regions stands out by about shift x sqrt(n) "
            "standard deviations to someone who knows the unmarked mean. Knowing that there is a mark removes none.",
            "An AUC well below 0.5 is a difference too, one that lies the other way round than what was learnt.",
        ],
        [shown],
        [Drawing("learned", partial(draw_areas, rows, title), caption)],
    )


def draw_roc(rows: Sequence[Row], title: str) -> Figure:
    """Fusion of the four detectors: our mark, and replaced bits at the lowest rate for scale."""
    drawn, axes = figure(width=5.6, height=4.6)
    unmarked = _scores(rows, "fusion", kind="unmarked")
    lowest = min(row["rate"] for row in picked(rows, kind="lsb"))
    series = {"our mark": picked(rows, kind="marked")}
    series[f"{100 * lowest:g} % of the LSBs replaced"] = picked(rows, kind="lsb", rate=lowest)
    axes.plot([0, 1], [0, 1], color=FAINT, linewidth=1.0, zorder=1)
    for style, (label, own) in zip(styles(), series.items(), strict=False):
        found = _scores(own, "fusion")
        thresholds = [np.inf, *np.unique(np.concatenate([unmarked, found]))[::-1]]
        false, hits = ([(scores >= t).mean() for t in thresholds] for scores in (unmarked, found))
        style |= {"label": f"{label}: AUC {area(unmarked, found):.3f}", "markevery": max(1, len(hits) // 12)}
        axes.plot(false, hits, **style)
    axes.set(xlabel="false alarms", ylabel="hits", xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), aspect="equal", title=title)
    axes.legend(loc="lower right")
    return drawn


def draw_check(rows: Sequence[Row], title: str) -> Figure:
    """Estimated over true embedding rate, mean and spread over pictures."""
    drawn, axes = figure()
    checked = picked(rows, kind="lsb")
    places = distinct(checked, "scene", "seed", "view")
    covers = [row for row in picked(rows, kind="unmarked") if (row["scene"], row["seed"], row["view"]) in places]
    true = [0.0, *sorted(distinct(checked, "rate"))]
    axes.plot([0, 1], [0, 1], color=FAINT, linewidth=1.0, zorder=1)
    for number, (style, name) in enumerate(zip(styles(), DETECTORS, strict=False)):
        values = [_scores([*covers, *checked], name, rate=rate) for rate in true]
        mean, spread = [np.mean(v) for v in values], [np.std(v) for v in values]
        axes.errorbar(np.array(true) + 0.008 * (number - 1.5), mean, yerr=spread, capsize=2, label=name, **style)
    axes.set(xlabel="true embedding rate", ylabel="estimated rate, mean and std over pictures", title=title)
    axes.legend()
    return drawn


def draw_areas(rows: Sequence[Row], title: str) -> Figure:
    """AUC of the learned detectors with intervals, a line for each case."""
    cases, names = list(dict.fromkeys(_case(row) for row in rows))[::-1], distinct(rows, "classifier")
    drawn, axes = figure(width=7.2, height=1.4 + 0.34 * len(cases), title=title)
    for number, (style, name) in enumerate(zip(styles(), names, strict=False)):
        shift = 0.24 * (0.5 - number / max(len(names) - 1, 1))
        own = picked(rows, classifier=name)
        auc, low, high = (_scores(own, field) for field in ("auc", "low", "high"))
        lines = [cases.index(_case(row)) + shift for row in own]
        style["linestyle"] = ""
        axes.errorbar(auc, lines, xerr=[auc - low, high - auc], capsize=2, label=name, **style)
    axes.set_yticks(range(len(cases)), cases)
    axes.set(xlabel="AUC of one region of about 512 Gaussians", xlim=(0.4, 1.03), ylim=(-0.6, len(cases) - 0.4))
    label_line(axes, 0.5, "chance", along="y")
    drawn.legend(loc="outside lower right", ncols=2)
    return drawn


def _case(row: Row) -> str:
    whose = "" if row["method"] == "ours" else f"{row['method']}: "
    return f"{whose}{row['attacker']}, {row['form']} ({row['scene']})"


STUDY = Study(
    "steganalysis",
    "Can the mark be seen without the key?",
    "Do detectors without the key, on renders or on the model's own numbers, do better than a coin?",
    cells,
    report,
    frozenset({"quick", "settings"}),
)
