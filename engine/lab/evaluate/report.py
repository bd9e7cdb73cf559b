"""Reports of studies: results.json, figures as SVG and PNG, and one self-contained HTML page; misses come first."""

import base64
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from engine.lab.evaluate.cell_runner import write_whole
from engine.lab.evaluate.figures import house_style, png, svg
from engine.lab.evaluate.machine import machine_info
from engine.lab.evaluate.study import Drawing, Options, Row, Study
from engine.numerics.plain import plain
from engine.present.html_pages import templates

__all__ = ["cell_text", "write_report"]

INFORMED = (
    "Extraction is informed: it uses the owner's record, which holds the unmarked original. Blind systems solve a "
    "harder problem."
)


def cell_text(value: Any) -> str:
    """A value as a table shows it: four digits of a float, nothing for None."""
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


TEMPLATES = templates(Path(__file__).parent, keep_trailing_newline=True)
TEMPLATES.filters["cell_text"] = cell_text


def write_report(study: Study, rows: Sequence[Row], options: Options, folder: Path) -> dict[str, Any]:
    """Write what all rows together say; a file is complete or as it was before.

    Returns
    -------
    dict
        ``report`` (path of the page), ``bars`` (misses first), ``summary``, ``figures``.
    """
    made = study.report(list(rows), options)
    bars = sorted(made.bars, key=lambda bar: {False: 0, None: 1, True: 2}[bar.met])
    folder.mkdir(parents=True, exist_ok=True)
    results = {
        "study": study.name,
        "title": study.title,
        "question": study.question,
        "scenes": [Path(scene).name for scene in options.scenes],
        "quick": options.quick,
        "seed": options.seed,
        "machine": machine_info(),
        "note": INFORMED,
        "bars": [vars(bar) for bar in bars],
        "answer": list(made.answer),
        "summary": made.summary,
        "rows": rows,
    }
    write_whole(folder / "results.json", (json.dumps(plain(results), indent=1) + "\n").encode())
    drawings = [drawing for section in made.sections for drawing in section.drawings]
    pictures = {drawing.name: _drawn(drawing, folder / "figures") for drawing in drawings}
    figures = [f"figures/{name}.{ending}" for name in pictures for ending in ("svg", "png")]
    shown = {"study": study, "made": made, "bars": bars, "options": options, "results": results, "pictures": pictures}
    page = TEMPLATES.get_template("report.html").render(shown)
    write_whole(folder / "report.html", page.encode())
    for name, text in made.pages.items():
        write_whole(folder / name, text.encode())
    return {"report": str(folder / "report.html"), "bars": results["bars"], "summary": made.summary, "figures": figures}


def _drawn(drawing: Drawing, folder: Path) -> str:
    """The figure, written to its two files, as base64 of its SVG."""
    with house_style():
        figure = drawing.make()
    folder.mkdir(exist_ok=True)
    vector = svg(figure)
    write_whole(folder / f"{drawing.name}.svg", vector)
    write_whole(folder / f"{drawing.name}.png", png(figure))
    return base64.b64encode(vector).decode()
