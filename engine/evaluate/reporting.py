"""Reports of studies: results.json, figures as SVG and PNG, and one self-contained HTML page; misses come first."""

import base64
import json
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from engine.evaluate.drawing import house_style, png, svg
from engine.evaluate.running import write_whole
from engine.evaluate.study import Bar, Options, Report, Row, Section, Study, Table
from engine.numerics.machine import machine_info
from engine.numerics.plain import plain

__all__ = ["cell_text", "write_report"]

INFORMED = (
    "Extraction is informed: it uses the owner's record, which holds the unmarked original. Blind systems solve a "
    "harder problem."
)
CSS = """
:root { color-scheme: light dark; --ink: #1a1a1a; --faint: #6a6a6a; --line: #ddd; --miss: #b00020; --met: #00694a; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #eee; --faint: #aaa; --line: #444; --miss: #ff8a80; --met: #7fd8be; } img { background: white; } }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { margin-bottom: 0 } h2 { margin-top: 2.5rem } .question, figcaption, footer { color: var(--faint) }
.wide { overflow-x: auto } table { border-collapse: collapse; font-size: .85rem; margin: 1rem 0 }
caption { text-align: left; font-weight: 600 } td, th { padding: .2rem .7rem; border-bottom: 1px solid var(--line);
text-align: left } td.n { text-align: right; font-variant-numeric: tabular-nums } figure { margin: 1.5rem 0 }
img { max-width: 100%; height: auto } .miss { color: var(--miss) } .met { color: var(--met) }
"""


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
    figures: list[str] = []
    sections = [_section(section, folder, figures) for section in made.sections]
    write_whole(folder / "report.html", _page(study, made, bars, sections, options).encode())
    return {"report": str(folder / "report.html"), "bars": results["bars"], "summary": made.summary, "figures": figures}


def _section(section: Section, folder: Path, names: list[str]) -> str:
    parts = [f"<h2>{escape(section.title)}</h2>", *(f"<p>{escape(text)}</p>" for text in section.text)]
    for drawing in section.drawings:
        with house_style():
            figure = drawing.make()
        vector, caption = svg(figure), escape(drawing.caption)
        (folder / "figures").mkdir(exist_ok=True)
        for ending, content in (("svg", vector), ("png", png(figure))):
            names.append(f"figures/{drawing.name}.{ending}")
            write_whole(folder / names[-1], content)
        source = "data:image/svg+xml;base64," + base64.b64encode(vector).decode()
        parts.append(f'<figure><img src="{source}" alt="{caption}"><figcaption>{caption}</figcaption></figure>')
    return "\n".join(parts + [_table(table) for table in section.tables])


def _page(study: Study, made: Report, bars: Sequence[Bar], sections: Sequence[str], options: Options) -> str:
    machine = ", ".join(f"{name} {value}" for name, value in machine_info().items())
    quick = ["<p><strong>A quick run: it shows that everything works, not how well.</strong></p>"]
    body = [
        f'<h1>{escape(study.title)}</h1><p class="question">{escape(study.question)}</p>',
        *(quick if options.quick else []),
        *(f"<p>{escape(text)}</p>" for text in made.answer),
        _bars(bars) if bars else "",
        *sections,
        f"<footer><p>{escape(INFORMED)}</p><p>Scenes: {escape(', '.join(Path(s).name for s in options.scenes))}. "
        f"Seed {options.seed}. Made by: mark3dgs evaluate --suite {study.name}"
        f"{' --quick' if options.quick else ''}. {escape(machine)}.</p></footer>",
    ]
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        f'content="width=device-width"><title>{escape(study.title)}</title><style>{CSS}</style></head>\n<body>\n'
        + "\n".join(body)
        + "\n</body></html>\n"
    )


def _bars(bars: Sequence[Bar]) -> str:
    words = {False: '<b class="miss">missed</b>', None: "not measured", True: '<span class="met">met</span>'}
    rows = "".join(
        f"<tr><td>{words[bar.met]}</td>"
        + "".join(f"<td>{escape(text)}</td>" for text in (bar.what, bar.wanted, bar.measured))
        + "</tr>"
        for bar in bars
    )
    head = "<tr><th></th><th>what</th><th>wanted</th><th>measured</th></tr>"
    return f'<h2>What was promised</h2><div class="wide"><table>{head}{rows}</table></div>'


def _table(table: Table) -> str:
    def entry(value: Any) -> str:
        return f"<td{' class=n' if isinstance(value, (int, float)) else ''}>{escape(cell_text(value))}</td>"

    head = "".join(f"<th>{escape(column)}</th>" for column in table.columns)
    body = "".join(f"<tr>{''.join(entry(value) for value in row)}</tr>" for row in table.rows)
    caption = f"<caption>{escape(table.title)}</caption>" if table.title else ""
    return f'<div class="wide"><table>{caption}<tr>{head}</tr>{body}</table></div>'


def cell_text(value: Any) -> str:
    """A value as a table shows it: four digits of a float, nothing for None."""
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
