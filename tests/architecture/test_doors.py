"""Every part of the simulator has a door: a step of a scenario, a key of an object, or a command."""

from __future__ import annotations

import ast
import re
from dataclasses import fields
from pathlib import Path

import pytest

from engine.lab.sim.scenario import KINDS
from engine.lab.sim.scenario.sources import Part, Photos, Scans
from tests.architecture.tree import ROOT, module_name, parse, product_files

DOORS = ("engine.cli.", "engine.lab.cli.", "engine.lab.sim.scenario.", "service.")
"""Who opens a door to the simulator; what only measures (`engine.lab.evaluate`) is none."""

MEASURING = {"engine.lab.sim.multiscale_ssim", "engine.lab.sim.variants.variant_table"}
"""Table 4, and the distance that it tells; their door is `mark3dgs evaluate`."""

TABLE = "## Parts and their doors"


def rows() -> list[list[str]]:
    """The cells of the table in docs/SIMULATOR.md."""
    text = (ROOT / "docs" / "SIMULATOR.md").read_text().split(TABLE, 1)[1].split("\n## ", 1)[0]
    lines = [line for line in text.splitlines() if line.startswith("|")][2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def named(doors: str) -> set[str]:
    """What a row names, commands apart."""
    return {word for word in re.findall(r"`([^`]+)`", doors) if not word.startswith("mark3dgs ")}


def test_the_table_names_every_step_and_nothing_else() -> None:
    keys = {one.name for kind in (Part, Photos, Scans) for one in fields(kind)}
    documented = set().union(*(named(row[1]) for row in rows()))
    assert sorted(set(KINDS) - documented) == []
    assert sorted(documented - set(KINDS) - keys) == []
    assert {"kind", "photos", "points", "odometry"} <= documented & keys


def test_no_cell_is_empty_and_commands_and_tests_exist() -> None:
    from engine.cli.app import add_extra_commands, app

    add_extra_commands(app)
    commands = {command.name for command in app.registered_commands}
    for row in rows():
        assert len(row) == 3, row
        assert all(row), row
        assert set(re.findall(r"`mark3dgs (\S+?)`", row[1])) <= commands, row
        for test in re.findall(r"`([^`]+)`", row[2]):
            assert "def test_" in (ROOT / test).read_text(), test


@pytest.mark.parametrize("word", KINDS)
def test_a_step_has_a_line_of_help(word: str) -> None:
    assert re.fullmatch(r"[^:\n]{10,}: \S.{1,90}", KINDS[word].summary), KINDS[word].summary


def test_the_steps_are_shown_by_shipped_scenarios() -> None:
    """Each of the simulator's own parts is played by one at least; thieves' attacks by name are not all."""
    shown = " ".join(path.read_text() for path in (ROOT / "docs" / "scenarios").glob("*.toml"))
    for word in (
        "collide",
        "insert",
        "map_edits",
        "known_edits",
        "undo",
        "scan",
        "level",
        "float16",
        "moment",
        "inventory",
    ):
        assert f'do = "{word}"' in shown, word
    for kind in ("discs", "codebook", "clip"):
        assert f'kind = "{kind}"' in shown, kind


def exports(gather: Path) -> dict[str, str]:
    """The names that a package gathers, and the modules they are from."""
    nodes = [node for node in parse(gather).body if isinstance(node, ast.ImportFrom) and node.module]
    return {alias.name: str(node.module) for node in nodes for alias in node.names}


def imported(path: Path, gathered: dict[str, dict[str, str]]) -> set[str]:
    """Modules that a file imports, at load or later; of a package's gathered names only those it uses."""
    found = set()
    packages: dict[str, dict[str, str]] = {}  # local name of a package that gathers
    for node in ast.walk(parse(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                found |= {node.module, whole, gathered.get(node.module, {}).get(alias.name, whole)}
                packages |= {alias.asname or alias.name: gathered[whole]} if whole in gathered else {}
    for node in ast.walk(parse(path)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            found.add(packages.get(node.value.id, {}).get(node.attr, ""))
    return found


def test_a_door_leads_to_every_module_of_the_simulator() -> None:
    files = {module_name(path): path for path in product_files()}
    gathered = {name: exports(path) for name, path in files.items() if path.name == "__init__.py"}
    reached = {name for name in files if name.startswith(DOORS)} - set(gathered)
    todo = list(reached)
    while todo:
        new = (imported(files[todo.pop()], gathered) & set(files)) - set(gathered) - reached
        reached |= new
        todo += new
    parts = {name for name in files if name.startswith("engine.lab.sim.")} - set(gathered)
    assert sorted(parts - reached - MEASURING) == []
