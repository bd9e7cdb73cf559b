"""What the steganalysis study says: bars, ROC, the detectors' own check, the learned detectors."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from engine.evaluate.steganalysis.figures import draw_areas, draw_check, draw_roc
from engine.evaluate.steganalysis.lsb import DETECTORS
from engine.evaluate.steganalysis.roc import area, area_interval, rates
from engine.evaluate.study import Bar, Drawing, Options, Report, Row, Section, Table

__all__ = ["report"]

HALF_WIDTH = 0.02
"""The bar: AUC within 0.5 +- 0.02."""
THRESHOLDS = (0.001, 0.003, 0.01, 0.02, 0.03, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 0.95)
"""The range of the paper's Figure 5; 0.2 is StegExpose's own."""
RECOVERED = 0.05
"""How far the mean estimate of the rate may lie from the truth for the detectors to count as right."""
RATE_DETECTORS = tuple(name for name in DETECTORS if name != "chi-square")
"""Chi-square sees full or sequential embedding, not a rate."""


def report(rows: list[Row], options: Options) -> Report:
    """Bars on both kinds of detector; figures and tables below them."""
    pictures = [row for row in rows if "fusion" in row]
    learned = [row for row in rows if "auc" in row]
    bars = [_fusion_bar(pictures), *_check_bars(pictures), *_learned_bars(learned)]
    seen = [bar for bar in bars if bar.met is False]
    answer = (
        "Every detector that was tried stays at chance."
        if not seen
        else "Not everything stays at chance: " + "; ".join(f"{bar.what}: {bar.measured}" for bar in seen) + "."
    )
    return Report(
        bars,
        [_pictures_section(pictures), _check_section(pictures), _learned_section(learned)],
        answer=[answer],
        summary={"auc": {name: _auc(pictures, name) for name in (*DETECTORS, "fusion")}},
    )


def _scores(rows: Sequence[Row], kind: str, name: str) -> np.ndarray:
    return np.array([row[name] for row in rows if row["kind"] == kind])


def _auc(rows: Sequence[Row], name: str) -> dict[str, float]:
    unmarked, marked = _scores(rows, "unmarked", name), _scores(rows, "marked", name)
    low, high = area_interval(unmarked, marked)
    return {"auc": area(unmarked, marked), "low": low, "high": high}


def _fusion_bar(rows: Sequence[Row]) -> Bar:
    found, count = _auc(rows, "fusion"), len(_scores(rows, "marked", "fusion"))
    return Bar(
        "StegExpose's fusion on renders: AUC, marked against unmarked",
        f"0.5 +- {HALF_WIDTH}",
        f"{found['auc']:.4f} (95 % {found['low']:.4f} to {found['high']:.4f}, {count} views)",
        abs(found["auc"] - 0.5) <= HALF_WIDTH,
    )


def _check_bars(rows: Sequence[Row]) -> list[Bar]:
    true = sorted({row["rate"] for row in rows if row["kind"] == "lsb"})
    worst, where = 0.0, ""
    for name in RATE_DETECTORS:
        for rate in true:
            mean = float(np.mean([row[name] for row in rows if row["kind"] == "lsb" and row["rate"] == rate]))
            if abs(mean - rate) >= worst:
                worst, where = abs(mean - rate), f"{name} reads {mean:.3f} where {rate:g} was embedded"
    unmarked = _scores(rows, "unmarked", "fusion")
    full = np.array([row["fusion"] for row in rows if row["kind"] == "lsb" and row["rate"] == true[-1]])
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
            f"{area(unmarked, full):.4f} ({len(full)} pictures)",
            area(unmarked, full) >= 0.99,
        ),
    ]


def _learned_bars(rows: Sequence[Row]) -> list[Bar]:
    bars = []
    for attacker in dict.fromkeys(row["attacker"] for row in rows if row["method"] == "ours"):
        for form in ("floats", "own format"):
            own = [
                row
                for row in rows
                if (row["method"], row["attacker"], row["form"]) == ("ours", attacker, form)
                and (attacker == "insider" or row["scene"] == "all")
            ]
            if not own:
                continue
            worst = max(own, key=lambda row: abs(row["auc"] - 0.5))
            measured = (
                f"{worst['auc']:.3f} (95 % {worst['low']:.3f} to {worst['high']:.3f}; {worst['classifier']}, "
                f"{worst['scene']})"
            )
            bars.append(
                Bar(
                    f"Learned detector on attributes, {attacker}, {form}: AUC of a region, worst case",
                    f"0.5 +- {HALF_WIDTH}",
                    measured,
                    abs(worst["auc"] - 0.5) <= HALF_WIDTH,
                )
            )
    if not any(row["attacker"] == "stranger" for row in rows):
        bars.append(
            Bar(
                "Learned detector on attributes, stranger: AUC of a region",
                f"0.5 +- {HALF_WIDTH}",
                "needs at least two scenes",
                None,
            )
        )
    return bars


def _pictures_section(rows: Sequence[Row]) -> Section:
    unmarked, marked = _scores(rows, "unmarked", "fusion"), _scores(rows, "marked", "fusion")
    lines = [[f"{t:g}", f"{100 * a:.1f} %", f"{100 * b:.1f} %"] for t, a, b in rates(unmarked, marked, THRESHOLDS)]
    areas = [
        [name, f"{found['auc']:.4f}", f"{found['low']:.4f} to {found['high']:.4f}"]
        for name in (*DETECTORS, "fusion")
        for found in [_auc(rows, name)]
    ]
    auc = _auc(rows, "fusion")["auc"]
    title = f"On renders, StegExpose's fusion has an AUC of {auc:.3f}"
    return Section(
        "On renders",
        [
            "The same views, unmarked and marked, as 8-bit pictures. Primary sets, chi-square, sample pairs and RS "
            "analysis, averaged as StegExpose does; own code. They look for replaced least significant bits, and our "
            "mark replaces none: it changes the scene before it is rounded. Staying at chance here says that these "
            "classic tools see nothing, not that nothing can. Intervals resample views."
        ],
        [
            Table(["detector", "AUC", "95 %"], areas, "Marked against unmarked"),
            Table(["threshold", "unmarked called marked", "marked called marked"], lines, "Fusion by threshold"),
        ],
        [
            Drawing(
                "roc",
                partial(draw_roc, rows, title),
                "ROC of the fusion on renders; pictures with replaced bits show what it can see.",
            )
        ],
    )


def _check_section(rows: Sequence[Row]) -> Section:
    return Section(
        "Are the detectors right?",
        ["Unmarked renders, least significant bits replaced at random in a known share of all places."],
        drawings=[
            Drawing(
                "check",
                partial(draw_check, rows, "The detectors recover the true embedding rate"),
                "Chi-square answers to full embedding only, as its authors say.",
            )
        ],
    )


def _learned_section(rows: Sequence[Row]) -> Section:
    lines = [
        [
            row["method"],
            row["attacker"],
            row["form"],
            row["scene"],
            row["classifier"],
            f"{row['auc']:.3f}",
            f"{row['low']:.3f} to {row['high']:.3f}",
            f"{row['shift']:+.2f}",
            row["regions"],
        ]
        for row in rows
    ]
    columns = [
        "method",
        "attacker",
        "form",
        "scene",
        "classifier",
        "AUC of a region",
        "95 %",
        "shift of the mean score (std of regions)",
        "regions",
    ]
    ours = [row for row in rows if row["method"] == "ours" and row["form"] != "lattice lost"]
    worst = max(ours, key=lambda row: abs(row["auc"] - 0.5))
    return Section(
        "On the model's own numbers",
        [
            "A classifier sees how the DC colours of a region of about 512 Gaussians differ from their neighbours' at "
            "three sizes, how they are distributed, and how often a value repeats; never a key. The insider has the "
            "unmarked model and marked copies of this very scene under other keys, and is asked about other regions "
            "under new keys; the stranger knows other scenes only.",
            "Forms: 'floats' is a model trained and delivered in floating point (files of few values are spread over "
            "their cells first); 'own format' is marked and delivered in the format it came in; 'lattice lost' is a "
            "file of few values delivered in floats, where the missing lattice alone gives the change away: a model "
            "that came as .splat or .sog should be delivered so.",
            "The shift says what many regions add up to: a mean over n regions stands out by about shift x sqrt(n) "
            "standard deviations to someone who knows the unmarked mean. Knowing that there is a mark removes none.",
            "An AUC well below 0.5 is a difference too, one that lies the other way round than what was learnt.",
        ],
        [Table(columns, lines)],
        [
            Drawing(
                "learned",
                partial(draw_areas, rows, _learned_title(worst)),
                "AUC of learned detectors on regions of the model, with 95 % intervals; 0.5 is a coin.",
            )
        ],
    )


def _learned_title(worst: Row) -> str:
    if abs(worst["auc"] - 0.5) <= HALF_WIDTH:
        return "Learned detectors on attributes stay at chance"
    return f"A learned detector sees the mark in the model's numbers: AUC up to {worst['auc']:.2f}"
