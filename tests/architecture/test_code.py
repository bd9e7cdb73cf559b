"""Rules on code that ruff has not: handlers, parameters, exports of packages. Syntax only, nothing is imported."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from pathlib import Path

from tests.architecture.tree import dotted, parse, product_files

Function = ast.FunctionDef | ast.AsyncFunctionDef
Rule = Callable[[ast.Module], Iterable[object]]
"""What a file's syntax tree has against a rule."""


def offenders(rule: Rule, files: Iterable[Path] = ()) -> dict[str, list[object]]:
    """What each file that breaks a rule has against it; all that ships, if no files are named."""
    found = {str(path): list(rule(parse(path))) for path in files or product_files()}
    return {path: faults for path, faults in found.items() if faults}


# --- handlers ----------------------------------------------------------------------------------------------

MOST_LINES = 15


def long_handlers(tree: ast.Module) -> Iterator[str]:
    """Functions that answer requests and have more lines than that, docstring not counted."""
    for node in ast.walk(tree):
        if isinstance(node, Function) and any("router." in ast.unparse(each) for each in node.decorator_list):
            body = node.body[1:] if ast.get_docstring(node) and len(node.body) > 1 else node.body
            if (lines := (node.end_lineno or 0) - body[0].lineno + 1) > MOST_LINES:
                yield f"{node.name}: {lines}"


def test_handlers_are_short() -> None:
    """What they do is said elsewhere, where it can be tested without a request."""
    assert offenders(long_handlers) == {}
    lines = "\n".join(f"    x = {number}" for number in range(16))
    code = f'@router.get("/")\ndef handler():\n    """Its own words."""\n{lines}\n\ndef other():\n{lines}'
    assert list(long_handlers(ast.parse(code))) == ["handler: 16"]


# --- parameters ---------------------------------------------------------------------------------------------

MOST_PARAMETERS = 8
"""More want a type: a frozen dataclass that names what belongs together."""
KERNELS = {"kernel", "parallel_kernel", "inlined"}
"""Decorators of compiled functions, which take arrays and numbers."""
WIDE = {
    "engine/kernels/native_probe.py": ["_probe"],
    "engine/lab/evaluate/cost/cost_cells.py": ["measure_size"],
    "engine/lab/raster/autograd.py": ["forward", "rasterize"],
    "engine/lab/sim/capture/photo_loss.py": ["_pull_back"],
    "engine/lab/sim/variants/variant_table.py": ["_row"],
    "engine/raster/cuda.py": ["rasterize"],
}
"""Functions with more, by file: to be fewer, never more."""


def wide_functions(tree: ast.Module) -> Iterator[str]:
    """Functions with more parameters, but for kernels and commands, whose parameters are options."""
    for node in ast.walk(tree):
        if not isinstance(node, Function) or KERNELS & {dotted(each).split(".")[-1] for each in node.decorator_list}:
            continue
        arguments = node.args
        named = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
        if any("typer." in ast.unparse(each.annotation) for each in named if each.annotation is not None):
            continue
        count = len(named) - (bool(named) and named[0].arg in ("self", "cls"))
        if count + bool(arguments.vararg) + bool(arguments.kwarg) > MOST_PARAMETERS:
            yield node.name


def test_functions_take_few_parameters() -> None:
    found = offenders(wide_functions)
    assert {path: sorted(map(str, names)) for path, names in found.items()} == WIDE
    nine = ", ".join("abcdefghi")
    code = f"def wide({nine}): ...\n@parallel_kernel\ndef fast({nine}): ...\ndef narrow(self, {nine[:-3]}): ..."
    assert list(wide_functions(ast.parse(code))) == ["wide"]


# --- exports -----------------------------------------------------------------------------------------------


def exports(tree: ast.Module) -> list[str] | None:
    """`__all__` as written, None where there is none."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and [dotted(t) for t in node.targets] == ["__all__"]:
            return list(ast.literal_eval(node.value))
    return None


def bound_names(tree: ast.Module) -> set[str]:
    """Names that a module binds at its top level, imports included."""
    names: set[str] = set()
    typed = [node.body for node in tree.body if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)]
    # What a package gathers for type checkers alone it loads on demand.
    versioned = [
        node.body for node in tree.body if isinstance(node, ast.If) and "version_info" in ast.unparse(node.test)
    ]
    for node in [*tree.body, *(node for body in (*versioned, *(typed if exports(tree) else ())) for node in body)]:
        if isinstance(node, Function | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            names |= {(alias.asname or alias.name).split(".")[0] for alias in node.names}
        elif isinstance(node, ast.Assign):
            names |= {n.id for t in node.targets for n in ast.walk(t) if isinstance(n, ast.Name)}
        elif isinstance(node, ast.AnnAssign):
            names.add(dotted(node.target))
    return names - {"annotations"}


def ungathered(tree: ast.Module) -> set[str]:
    """Public names of a package that it does not export."""
    return {name for name in bound_names(tree) if not name.startswith("_")} ^ set(exports(tree) or [])


def test_a_package_exports_exactly_what_it_gathers() -> None:
    packages = [path for path in product_files() if path.name == "__init__.py"]
    assert len(packages) > 20
    assert not offenders(ungathered, packages)


def test_export_rules_see_what_they_look_for() -> None:
    assert ungathered(ast.parse("from a import B, c\n__all__ = ['c', 'd', 'B']")) == {"d"}
    on_demand = ast.parse("if _typing.TYPE_CHECKING:\n    from a import b, c\n__all__ = ['b', 'd']")
    assert ungathered(on_demand) == {"c", "d"}


# --- documentation -----------------------------------------------------------------------------------------


def documented_parameters(text: str) -> list[str]:
    """Names in the Parameters section of a numpydoc text."""
    lines = text.splitlines()
    heads = [i for i, line in enumerate(lines[1:]) if re.fullmatch(r"-{3,}", line.strip())]
    for head, following in pairwise([*heads, len(lines)]):
        if lines[head].strip() != "Parameters":
            continue
        margin = len(lines[head]) - len(lines[head].lstrip())
        names = []
        for line in lines[head + 2 : following]:
            if line.strip() and len(line) - len(line.lstrip()) == margin:
                names += [name.strip().lstrip("*") for name in line.partition(" :")[0].split(",")]
        return names
    return []


def real_parameters(node: Function) -> set[str]:
    """Names of all parameters of a function."""
    a = node.args
    every = [*a.posonlyargs, *a.args, *a.kwonlyargs, *(x for x in (a.vararg, a.kwarg) if x is not None)]
    return {argument.arg for argument in every}


def class_parameters(node: ast.ClassDef) -> set[str]:
    """Fields of a dataclass or enumeration of settings, and parameters of a written `__init__`."""
    names = {dotted(item.target) for item in node.body if isinstance(item, ast.AnnAssign)}
    for item in node.body:
        if isinstance(item, Function) and item.name == "__init__":
            names |= real_parameters(item)
    return names


def false_names(tree: ast.Module) -> list[str]:
    """`owner: name` for each documented parameter that is none."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, Function):
            known = real_parameters(node)
        elif isinstance(node, ast.ClassDef):
            known = class_parameters(node)
        else:
            continue
        named = documented_parameters(ast.get_docstring(node) or "")
        found += [f"{node.name}: {name}" for name in named if name not in known]
    return found


def test_documented_parameters_are_the_real_ones() -> None:
    assert not offenders(false_names)


def test_documentation_rules_see_what_they_look_for() -> None:
    code = '''
def f(a, *, b, **options):
    """Say.

    Parameters
    ----------
    a, c : int
        An a : of sorts.
    b : int
    **options
        More.

    Returns
    -------
    nothing : None
    """

class C:
    """Hold.

    Parameters
    ----------
    x : int
    y : int
    """

    x: int
'''
    assert false_names(ast.parse(code)) == ["f: c", "C: y"]
