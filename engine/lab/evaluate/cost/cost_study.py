"""The study `cost`: how time and memory grow, what storage takes.

On two cores the full study takes about 15 minutes a scene of 100,000 Gaussians and needs 13 GB for its largest
size; the quick version less than half a minute.
"""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from engine.lab.evaluate.cost.cost_charts import Curve, Growth, draw_formats, draw_growth, fit_growth
from engine.lab.evaluate.study import Bar, Cell, Drawing, Options, Report, Row, Section, Study
from engine.lab.evaluate.summary import busy_words, picked, table

MODULE = "engine.lab.evaluate.cost.cost_cells"
GAUSSIANS = (10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000, 10_000_000)
VIEWS = (1, 4, 16, 64)
SIZES = (256, 512, 1024, 2048)
FORMATS = ("ply", "splat", "spz", "compressed.ply", "sog")
LARGE = 1_000_000
"""From here on each embedding is timed once."""
BAR_GAUSSIANS = 500_000
BARS = {
    "embed, s": ("embed fast", 15.0),
    "verify model, s": ("verify a model", 3.0),
    "verify picture, s": ("verify a picture", 3.0),
}
"""Seconds that so many Gaussians may take."""
AXES = {"gaussians": "Gaussians", "views": "key views", "pixels": "pixels a side, key views and picture"}
COSTS: dict[str, Callable[[Row], float]] = {
    "embed, s": lambda row: float(sum(row["stages"].values())),
    "verify model, s": lambda row: float(row["verify_model_s"]),
    "verify picture, s": lambda row: float(row["verify_picture_s"]),
    "forward, s": lambda row: float(row["forward_ms"]) / 1000.0,
    "colour backward, s": lambda row: float(row["backward_color_ms"]) / 1000.0,
}


def _cells(options: Options) -> list[Cell]:
    return [cell for number, scene in enumerate(options.scenes) for cell in _of_scene(number, scene, options)]


def _of_scene(number: int, scene: str, options: Options) -> list[Cell]:
    quick = options.quick
    light: dict[str, Any] = (
        {"landmarks": 0, "view_size": 96, "repeats": 1, "raster_size": [160, 100], "picture_size": 96, "apart": False}
        if quick
        else {}
    )
    stem = Path(scene).stem.replace(" ", "-")
    cells: list[Cell] = []

    def measured(name: str, work: str, **arguments: Any) -> None:
        cells.append(Cell(f"{number}-{stem}-{name}", f"{MODULE}:{work}", {"scene": scene, **arguments}))

    def add(axis: str, size: int, **arguments: Any) -> None:
        shared = {"axis": axis, "size": size, "seed": options.seed}
        measured(f"{axis}-{size}", "measure_size", **{**shared, **light, **arguments})

    for count in (2_500, 5_000) if quick else GAUSSIANS:
        once = {} if quick or count < LARGE else {"repeats": 1}
        add("gaussians", count, gaussians=count, **once)
    thinned = {"gaussians": 5_000} if quick else {}
    for views in (1, 4) if quick else VIEWS:
        add("views", views, views=views, **{"landmarks": 0, **thinned})
    for size in (64, 160) if quick else SIZES:
        add("pixels", size, view_size=size, raster_size=[size, size], **{"landmarks": 0, **thinned})
    formats = ["splat", "sog"] if quick else list(FORMATS)
    measured("formats", "measure_formats", formats=formats)
    return cells


def _report(rows: list[Row], options: Options) -> Report:
    names = {number: Path(scene).name for number, scene in enumerate(options.scenes)}
    rows = [{**row, "scene": names[int(row["cell"].split("-", 1)[0])]} for row in rows]
    sections, summary, bars = [], {}, []
    for scene in names.values():
        own = [row for row in rows if row["scene"] == scene and "axis" in row]
        exponents: dict[str, dict[str, str]] = {}
        for axis, words in AXES.items():
            found = sorted(picked(own, axis=axis), key=lambda row: row["size"])
            curves = _curves(found)
            exponents[axis] = {name: str(curve[2]) for name, curve in curves.items()}
            sections.append(_growth_section(scene, axis, words, found, curves))
        summary[scene] = exponents
        bars += _bars(scene, own)
    formats = [row for row in rows if "format" in row]
    sections.append(_formats_section(formats))
    answer = [*(_answer(scene, said) for scene, said in summary.items()), *busy_words(rows)]
    return Report(bars, sections, answer, {"exponents": summary})


def _answer(scene: str, exponents: dict[str, dict[str, str]]) -> str:
    parts = [f"with the {AXES[axis]} as the power {said['embed, s']}" for axis, said in exponents.items()]
    return f"{scene}: the time to embed grows {', '.join(parts)} (95 %)."


def _growth_of(rows: Sequence[Row], cost: Callable[[Row], float]) -> Growth:
    return fit_growth([row["size"] for row in rows], [cost(row) for row in rows])


def _curves(found: Sequence[Row]) -> dict[str, Curve]:
    sizes = [float(row["size"]) for row in found]
    return {name: (sizes, [cost(row) for row in found], _growth_of(found, cost)) for name, cost in COSTS.items()}


def _growth_section(scene: str, axis: str, words: str, found: Sequence[Row], curves: dict[str, Curve]) -> Section:
    title = f"{scene}: cost over {words.split(',')[0]}"
    low, high = found[0], found[-1]
    finding = (
        f"From {low['size']:,} to {high['size']:,} {words.split(',')[0]}: embedding takes "
        f"{COSTS['embed, s'](low):.2g} to {COSTS['embed, s'](high):.2g} s"
    )
    text = [
        "Each size runs in a process of its own; medians of repeats, one from 1,000,000 Gaussians on. Exponents are of "
        "a straight line through all points on log-log axes, with Student's 95 % interval: what costs the same at "
        "every size pulls them down."
    ]
    if axis == "gaussians":
        text.append("Smaller sizes are the scene thinned at random, larger ones a grid of turned copies of it.")
    else:
        text.append("Without the landmark bank, which does not depend on the key views.")
    growths = [{"cost": name, "growth": growth} for name, (_, _, growth) in curves.items()]
    growths.append({"cost": "peak memory", "growth": _growth_of(found, lambda row: float(row["peak_memory_mb"]))})
    tables = [
        table(
            found,
            (words, "size"),
            ("Gaussians", "gaussians"),
            ("embed s", COSTS["embed, s"]),
            *((f"{stage} s", lambda row, stage=stage: row["stages"][stage]) for stage in low["stages"]),
            ("verify model s", "verify_model_s"),
            ("verify picture s", "verify_picture_s"),
            ("forward ms", "forward_ms"),
            ("colour backward ms", "backward_color_ms"),
            ("backward ms", "backward_ms"),
            ("peak MB, embed", "peak_memory_mb"),
            title="Measured",
        ),
        table(growths, "cost", ("exponent (95 %)", lambda line: str(line["growth"])), title="Growth"),
    ]
    drawing = Drawing(
        f"growth-{axis}-{Path(scene).stem.replace(' ', '-')}",
        partial(draw_growth, curves, words, "seconds", finding),
        f"{scene}: seconds over {words}, log-log.",
    )
    return Section(title, text, tables, [drawing])


def _bars(scene: str, own: Sequence[Row]) -> list[Bar]:
    """Embedding and verifying 500,000 Gaussians, read off the fitted growth where no cell has just as many."""
    found = picked(own, axis="gaussians")
    if max((row["size"] for row in found), default=0) < BAR_GAUSSIANS:
        return []
    near = [row for row in found if 100_000 <= row["size"] <= LARGE]
    bars = []
    for name, (what, limit) in BARS.items():
        line = _growth_of(near, COSTS[name])
        value = line.factor * BAR_GAUSSIANS**line.exponent
        measured = f"{value:.1f} s (line through {len(near)} sizes from 100,000 to 1,000,000)"
        bars.append(Bar(f"{scene}: {what}, 500,000 Gaussians", f"<= {limit:g} s", measured, value <= limit))
    return bars


def _formats_section(rows: Sequence[Row]) -> Section:
    shown = table(
        rows,
        "scene",
        "format",
        ("SH degree", "sh_degree"),
        "bytes",
        ("bytes a Gaussian", lambda row: row["bytes"] / row["gaussians"]),
        ("write s", "write_s"),
        ("read s", "read_s"),
    )
    return Section(
        "Storage by format",
        ["The marked model as each format holds it; .splat keeps no SH beyond degree 0."],
        [shown],
        [Drawing("formats", partial(draw_formats, rows), "Bytes a Gaussian of the marked model.")],
    )


STUDY = Study("cost", "What it costs", "How do time and memory grow with Gaussians, views and pixels?", _cells, _report)
