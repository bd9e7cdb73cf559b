"""The program of docs/API.md, run as written, and its table of names."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import mark3dgs
import pytest

ROOT = Path(__file__).parents[2]
INSTALLED = ROOT / "service" / "installed"
PAGE = (ROOT / "docs" / "API.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)


def test_the_page_names_what_the_package_exports() -> None:
    """In its table, and each of them but the two nouns in a block, too."""
    table = {name for line in PAGE.splitlines() if line.startswith("| `") for name in re.findall(r"`(\w+)`", line)}
    assert table >= set(mark3dgs.__all__)
    tree = ast.parse("".join(BLOCK.findall(PAGE)))
    used = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    assert set(mark3dgs.__all__) - used == {"Camera", "GaussianModel"}


def test_every_name_is_what_type_checkers_are_told() -> None:
    """The block for type checkers and the map that the interpreter reads are two lists of one thing."""
    tree = ast.parse((INSTALLED / "mark3dgs" / "__init__.py").read_text(encoding="utf-8"))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    declared = {alias.name: node.module for node in imports for alias in node.names}
    assert declared == {name: home for home, names in mark3dgs._HOMES.items() for name in names}
    for name in mark3dgs.__all__:
        assert getattr(mark3dgs, name).__name__ == name
        assert name in dir(mark3dgs)
    assert mark3dgs.__all__ == sorted(declared)
    assert not hasattr(mark3dgs, "no_such_name")


@pytest.mark.long
def test_the_program_runs_as_written(tmp_path: Path) -> None:
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "data").symlink_to(ROOT / "tests" / "data")
    program = tmp_path / "page.py"
    program.write_text("\n".join(BLOCK.findall(PAGE)), encoding="utf-8")
    code = f"import sys; sys.path[:0] = [{str(ROOT)!r}, {str(INSTALLED)!r}]; exec(open('page.py').read())"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=280, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "WrongKeyError" in done.stdout
