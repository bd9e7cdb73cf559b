"""The tree that the rules look at: files under version control, parsed once."""

from __future__ import annotations

import ast
import subprocess
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SKIPPED = {".venv", ".git", "build", "dist", "__pycache__", "node_modules"}
PRODUCT = ("engine", "service")
"""Packages that ship."""


@cache
def tracked_files() -> tuple[Path, ...]:
    """Files under version control that exist, relative to the root; every file where there is no git."""
    try:
        listing = subprocess.run(
            ["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, timeout=60
        ).stdout.decode()
        names = [Path(name) for name in listing.split("\0") if name]
    except (OSError, subprocess.CalledProcessError):
        names = [path.relative_to(ROOT) for path in ROOT.rglob("*") if not SKIPPED & set(path.parts)]
    return tuple(sorted(name for name in names if (ROOT / name).is_file()))


def product_files() -> list[Path]:
    """The Python files of the packages that ship."""
    return [path for path in tracked_files() if path.suffix == ".py" and path.parts[0] in PRODUCT]


@cache
def parse(path: Path) -> ast.Module:
    """Syntax tree of a file, given relative to the root."""
    return ast.parse((ROOT / path).read_text(encoding="utf-8"), filename=str(path))


def module_name(path: Path) -> str:
    """Dotted name of a file's module."""
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def dotted(node: ast.AST) -> str:
    """`a.b.c` for a chain of attributes, otherwise an empty string."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        head = dotted(node.value)
        return f"{head}.{node.attr}" if head else ""
    return ""
