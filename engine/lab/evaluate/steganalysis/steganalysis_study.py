"""Suite 5 (the paper's Figure 5): can it be seen, without the key, that there is a mark?

Full, on 2 cores and a scene of 100k Gaussians: 2 keys x 100 renders about 2 minutes; the learned detector, 4 + 4 keys,
about 1 minute for each of two forms. Quick: 24 renders, one key and one form, about half a minute.
"""

from collections.abc import Sequence

import numpy as np

from engine.errors import InputError
from engine.lab.evaluate.intervals import area, area_interval
from engine.lab.evaluate.steganalysis.copy_differences import SECRETS, compare_copies
from engine.lab.evaluate.steganalysis.learned_detectors import FORMS, detect_as_insider
from engine.lab.evaluate.steganalysis.picture_detectors import DETECTORS, look_at_renders
from engine.lab.evaluate.study import Bar, Cell, Options, Report, Row, Section, Study, Table
from engine.lab.evaluate.summary import grouped, picked, table
from engine.model import Float64

__all__ = ["STUDY"]

PARTS = ("renders", "insider", "differences")
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
    """Renders of each scene and key; insiders of each scene and form; differences of copies.

    `options.settings` chooses among these PARTS; InputError where it names another.
    """
    if unknown := [name for name in options.settings if name not in PARTS]:
        raise InputError(f"there is no part {unknown[0]!r}; there are {', '.join(PARTS)}")
    seeds, views, checked, size, keys = (1, 24, 3, 256, 1) if options.quick else (2, 100, 10, 512, 4)
    forms = FORMS[:1] if options.quick else FORMS
    common = {"profile_name": PROFILE, "seed": options.seed}
    looks = {"views": views, "checked_views": checked, "size": size}
    made = []
    for number, path in enumerate(options.scenes):
        for seed in range(options.seed, options.seed + seeds):
            arguments = {**common, **looks, "path": path, "seed": seed}
            made.append(Cell.of(f"renders-{number}-{seed}", look_at_renders, **arguments))
        for form in forms:
            name = f"insider-{number}-{form.replace(' ', '-')}"
            made.append(Cell.of(name, detect_as_insider, **common, path=path, keys=keys, form=form))
        pairs = {"form": "floats", "pairs": 1 if options.quick else 2}
        made.append(Cell.of(f"differences-{number}", compare_copies, **common, path=path, **pairs))
    return [cell for cell in made if cell.name.split("-")[0] in (options.settings or PARTS)]


def report(rows: list[Row], options: Options) -> Report:
    """Bars on both kinds of detector; tables below them."""
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
            *([_pictures_section(pictures, areas)] if pictures else []),
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
    for form, own in grouped(rows, "form").items():
        worst = max(own, key=_off)
        measured = "{auc:.3f} (95 % {low:.3f} to {high:.3f}; {classifier}, {scene})".format_map(worst)
        promise = f"Learned detector on attributes, {form}: AUC of a region, worst case"
        bars.append(Bar(promise, CHANCE, measured, _off(worst) <= HALF_WIDTH))
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
    )


def _learned_section(rows: Sequence[Row]) -> Section:
    shown = table(
        rows,
        "form",
        "scene",
        "classifier",
        ("AUC of a region", "{auc:.3f}"),
        ("95 %", "{low:.3f} to {high:.3f}"),
        ("shift of the mean score (std of regions)", "{shift:+.2f}"),
        "regions",
    )
    return Section(
        "On the model's own numbers",
        [
            "A classifier sees how the DC colours of a region of about 512 Gaussians differ from their neighbours' at "
            "three sizes, how they are distributed, and how often a value repeats; never a key. The insider has the "
            "unmarked model and marked copies of this very scene under other keys, and is tested on other regions "
            "under new keys.",
            "Forms: 'floats' is a model trained and delivered in floating point (files of few values are spread over "
            "their cells first); 'own format' is marked and delivered in the format it came in.",
            "The shift says what many regions add up to: a mean over n regions stands out by about shift x sqrt(n) "
            "standard deviations to someone who knows the unmarked mean. Knowing that there is a mark removes none.",
            "An AUC well below 0.5 is a difference too, one that lies the other way round than what was learnt.",
        ],
        [shown],
    )


STUDY = Study(
    "steganalysis",
    "Can the mark be seen without the key?",
    "Do detectors without the key, on renders or on the model's own numbers, do better than a coin?",
    cells,
    report,
    frozenset({"quick", "settings"}),
)
