"""Citations lead somewhere: "DESIGN n" and "Eq n" to a heading of docs/DESIGN.md, its table of equations to code."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path

import pytest

from tests.architecture.tree import ROOT, module_name, parse, tracked_files

PAGE = (ROOT / "docs" / "DESIGN.md").read_text(encoding="utf-8")
MOST_FILES = 5
"""From a command, through its request, to an equation."""

NUMBERS = r"\d+(?:\.\d+)?(?:(?:, | and | to )\d+(?:\.\d+)?)*"
SECTIONS = re.compile(rf"\bDESIGN(?: section)?s? ({NUMBERS})")
EQUATIONS = re.compile(rf"\bEqs? ({NUMBERS})")
CITING = (".py", ".toml", ".md", ".html", ".js", ".yaml")
FOLDERS = ("engine", "service", "tests", "docs")

Row = tuple[str, str, str, str]


def numbers(cited: str) -> list[str]:
    """The numbers that a citation names: "4, 5", "10 and 11", "4 to 6"."""
    found = re.findall(r"\d+(?:\.\d+)?", cited)
    if " to " in cited and "." not in cited:
        return [str(number) for number in range(int(found[0]), int(found[-1]) + 1)]
    return found


def headings(pattern: str) -> set[str]:
    return set(re.findall(pattern, PAGE, re.MULTILINE))


def cited(pattern: re.Pattern[str]) -> dict[str, list[str]]:
    """Number: the files that cite it."""
    found: dict[str, list[str]] = {}
    for path in tracked_files():
        if path.parts[0] in FOLDERS and path.suffix in CITING and path != Path(__file__).relative_to(ROOT):
            text = re.sub(r"\s*\n[\s#*/]*", " ", (ROOT / path).read_text(encoding="utf-8"))  # a line may end in between
            for match in pattern.finditer(text):
                for number in numbers(match[1]):
                    found.setdefault(number, []).append(str(path))
    return found


def test_citations_are_seen() -> None:
    assert numbers("4.2, 4.3") == ["4.2", "4.3"]
    assert numbers("10 and 11") == ["10", "11"]
    assert numbers("4 to 6") == ["4", "5", "6"]
    assert len(cited(SECTIONS)) > 8
    assert len(cited(EQUATIONS)) > 8


def test_every_section_cited_is_a_heading() -> None:
    known = headings(r"^#+ (\d+(?:\.\d+)?)\.? ")
    assert not {number: files for number, files in cited(SECTIONS).items() if number not in known}


def test_every_equation_cited_is_a_heading() -> None:
    """Those of other works are called "equation n" of a named work, never "Eq n"."""
    known = headings(r"^### Eq (\d+)$")
    assert not {number: files for number, files in cited(EQUATIONS).items() if number not in known}


def test_files_and_names_of_the_page_exist() -> None:
    """A file by the end of its path, a name by being written anywhere in the code."""
    tokens = re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", PAGE, flags=re.DOTALL))
    files = [
        token for token in tokens if re.fullmatch(r"[\w./]+\.(py|toml|md|json)|(engine|service|tests)/[\w/]*", token)
    ]
    names = {token.split(".")[-1] for token in set(tokens) - set(files) if re.fullmatch(r"[A-Za-z_][\w.]*", token)}
    code = [path for path in tracked_files() if path.suffix in (".py", ".toml") and path.parts[0] != "docs"]
    words = {word for path in code for word in re.findall(r"\w+", (ROOT / path).read_text(encoding="utf-8"))}
    folders = {str(folder) for path in tracked_files() for folder in path.parents}
    known = [f"/{path}" for path in tracked_files()] + [f"/{folder}" for folder in folders]
    assert len(files) > 40
    assert not [file for file in files if not any(path.endswith(f"/{file.rstrip('/')}") for path in known)]
    assert not sorted(names - words - {"NAME"})


# --- the table of equations ----------------------------------------------------------------------------------


@cache
def table() -> tuple[Row, ...]:
    lines = PAGE.split("### From the command line to an equation")[1].split("\n## ")[0].splitlines()
    rows = [tuple(cell.strip() for cell in line.strip("|").split(" | ")) for line in lines if line.startswith("| Eq ")]
    assert all(len(row) == 4 for row in rows)
    return tuple((row[0], row[1], row[2], row[3].rstrip(" |")) for row in rows)


def file_and_names(cell: str) -> tuple[Path, list[str]]:
    """Of a cell such as `path`: `name`, `name`."""
    path, *names = re.findall(r"`([^`]+)`", cell)
    return Path(path), names


def defined(path: Path) -> set[str]:
    nodes = ast.walk(parse(path))
    return {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)}


def imported(path: Path) -> Iterator[str]:
    """Modules that a file imports anywhere, and what a package that it imports from gathers."""
    for node in ast.walk(parse(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
            package = Path(*node.module.split("."), "__init__.py")
            if package != path and (ROOT / package).is_file():
                yield from imported(package)


def test_every_equation_has_a_row() -> None:
    assert {row[0] for row in table()} == {f"Eq {number}" for number in headings(r"^### Eq (\d+)$")}


@pytest.mark.parametrize("row", table(), ids=lambda row: f"{row[0]}: {row[1]}")
def test_the_table_names_what_exists(row: Row) -> None:
    for cell in row[1:3]:
        if cell.startswith("none"):
            continue
        path, names = file_and_names(cell)
        assert (ROOT / path).is_file(), path
        assert names
        assert not set(names) - defined(path), path


@pytest.mark.parametrize("row", table(), ids=lambda row: f"{row[0]}: {row[1]}")
def test_the_way_from_a_command_is_one_of_imports(row: Row) -> None:
    if row[3].startswith("none"):
        return
    way = [Path(name) for name in re.findall(r"`([^`]+)`", row[3])]
    assert way[0].parent == Path("engine/cli")
    assert way[-1] == file_and_names(row[1])[0]
    assert len(way) <= MOST_FILES
    for here, there in pairwise(way):
        assert module_name(there) in set(imported(here)), f"{here} does not import {there}"
