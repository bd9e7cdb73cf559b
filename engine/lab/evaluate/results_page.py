"""docs/RESULTS.md and what the annex of a claim shows, from the numbers in docs/results:
`python -m engine.lab.evaluate.results_page FOLDER PAGE ANNEX`.

A file of the folder is one result, a table with the command that measured it; the fields are those of `Result`. Files
are shown in the order of their names. The misses of all of them come first.
"""

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from engine.errors import InputError

__all__ = ["Bar", "Result", "draw_page", "error_rates", "main", "read_results"]

UNKNOWN = "not recorded"
"""For a seed, machine or commit that was not written down when the numbers were measured."""

HEAD = """# Results
Current numbers only. This page is written by `python -m engine.lab.evaluate.results_page docs/results docs/RESULTS.md
service/claims/error_rates.json` from the files in [results](results); edit those. What earlier versions measured is in
[history](history), the paper's numbers next to ours in [PAPER.md](PAPER.md).

Detection is **informed** throughout: it uses the owner's record, which holds the unmarked original. Blind methods solve
a harder problem. z is the detection score: a claim needs z 13.6 at 1 in 2^128 and, where a time-stamping
service drew, z 8.5 at 1 in 10^9; a little more where more hypotheses are tested. Scenes are captures of 90,000
to 524,000 Gaussians; the plant alone ships here. Where a result says "script not kept", no command of this repository
repeats it. Results of commits before c8649895 were measured with records of format 2, before copies shared a layer,
unless they name format 3.
"""


@dataclass(frozen=True)
class Bar:
    """What was required, what was measured, whether that meets it, and whether it is about errors of claims."""

    bar: str
    measured: str
    met: bool
    rate: bool = False


@dataclass(frozen=True)
class Result:
    """One measurement as its file has it.

    Attributes
    ----------
    what : str
        The title of the table.
    command : str
        What measured it, or "script not kept".
    seed, machine : str
        `UNKNOWN` where it was not written down.
    commit : str
        The one that was measured or, for older numbers, the first that holds them; or `UNKNOWN`.
    columns : tuple of str
    rows : tuple of tuple of str
        Each as long as `columns`.
    tested : str
        Scenes, keys and suspects of a result that the annex of a claim shows; "" for others.
    bars : tuple of Bar
    notes : tuple of str
        What the reader must know besides the numbers, one sentence or two each.
    """

    what: str
    command: str
    seed: str
    machine: str
    commit: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    tested: str = ""
    bars: tuple[Bar, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise InputError(f"{self.what}: a row has {len(row)} cells, expected {len(self.columns)}: {row}")


def read_results(folder: Path) -> dict[str, Result]:
    """All results of a folder, by their files' names without the ending, and in their order.

    Raises
    ------
    InputError
        If the folder holds no results, or a file has a missing or unknown field or a row of another length.
    """
    results = {path.stem: _read(path) for path in sorted(folder.glob("*.json"))}
    if not results:
        raise InputError(f"{folder}: no results")
    return results


def _read(path: Path) -> Result:
    entries: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    known = {field.name for field in fields(Result)}
    if unknown := sorted(set(entries) - known):
        raise InputError(f"{path}: unknown fields {unknown}")
    if missing := sorted(known - {"tested", "bars", "notes"} - set(entries)):
        raise InputError(f"{path}: missing fields {missing}")
    entries["columns"] = tuple(entries["columns"])
    entries["rows"] = tuple(tuple(row) for row in entries["rows"])
    entries["bars"] = tuple(Bar(**bar) for bar in entries.get("bars", ()))
    entries["notes"] = tuple(entries.get("notes", ()))
    return Result(**entries)


def error_rates(results: Mapping[str, Result]) -> str:
    """Results that say what was tested, by their files' names, with their bars on errors of claims: a line each."""
    lines = []
    for name, result in results.items():
        if result.tested:
            bars = [asdict(bar) for bar in result.bars if bar.rate]
            shown = {
                field: getattr(result, field) for field in ("what", "tested", "command", "commit", "columns", "rows")
            }
            lines.append(f"{json.dumps(name)}: {json.dumps(shown | {'bars': bars}, ensure_ascii=False)}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def draw_page(results: Mapping[str, Result]) -> str:
    """The page in Markdown: all misses, then each table with the bars that it meets."""
    every = [(result, bar) for result in results.values() for bar in result.bars]
    missed = [(result, bar) for result, bar in every if not bar.met]
    lines = [HEAD, f"## Misses: {len(missed)} of {len(every)} bars", *_bars(missed), ""]
    for result in results.values():
        lines += _section(result)
    return "\n".join(lines).rstrip() + "\n"


def _bars(bars: list[tuple[Result, Bar]]) -> list[str]:
    rows = [(f"[{result.what}](#{_anchor(result.what)})", bar.bar, bar.measured) for result, bar in bars]
    return _table(("what", "bar", "measured"), rows)


def _section(result: Result) -> list[str]:
    measured = (f"seed {result.seed}", result.machine, f"commit {result.commit}")
    known = [entry for entry in measured if UNKNOWN not in entry]
    by = result.command if " " not in result.command else f"`{result.command}`"
    by = "Script not kept" if result.command == "script not kept" else by
    met = "; ".join(f"{bar.bar} ({bar.measured})" for bar in result.bars if bar.met)
    tested = [result.tested] if result.tested else []
    said = ["; ".join([by, *known]) + ".", *([f"Bars met: {met}."] if met else []), *tested, *result.notes]
    return [f"## {result.what}", *_table(result.columns, result.rows), "", " ".join(said), ""]


def _table(columns: tuple[str, ...], rows: Any) -> list[str]:
    return [_row(columns), _row(("---",) * len(columns)), *(_row(row) for row in rows)]


def _row(cells: tuple[str, ...]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _anchor(title: str) -> str:
    """As GitHub names the heading."""
    return "".join(c for c in title.lower().replace(" ", "-") if c.isalnum() or c in "-_")


def main(arguments: list[str]) -> int:
    """Write both files; exit code 2 for wrong usage or files."""
    if len(arguments) != 3:
        sys.stderr.write("usage: python -m engine.lab.evaluate.results_page FOLDER PAGE ANNEX\n")
        return 2
    folder, page, annex = map(Path, arguments)
    try:
        results = read_results(folder)
        page.write_text(draw_page(results), encoding="utf-8")
        annex.write_text(error_rates(results), encoding="utf-8")
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
