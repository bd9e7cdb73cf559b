"""No module imports itself through others: an import inside a function hides a circle, it cuts none."""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterator
from graphlib import CycleError, TopologicalSorter

from tests.architecture.tree import dotted, module_name, parse, product_files


def imports(node: ast.AST) -> Iterator[ast.Import | ast.ImportFrom]:
    """Every import below a node, functions included, but for those that only a type checker runs."""
    if isinstance(node, ast.Import | ast.ImportFrom):
        yield node
    elif isinstance(node, ast.If) and dotted(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
        for other in node.orelse:
            yield from imports(other)
    else:
        for child in ast.iter_child_nodes(node):
            yield from imports(child)


def imported(tree: ast.Module, package: str, modules: Collection[str]) -> set[str]:
    """Those of `modules` that a file of a package names: `from a import b` is a.b where that is one, else a."""
    found = set()
    for node in imports(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
            continue
        above = package.split(".")[: len(package.split(".")) + 1 - node.level] if node.level else []
        base = ".".join([*above, *([node.module] if node.module else [])])
        inner = {f"{base}.{alias.name}" for alias in node.names}
        found |= {name if name in modules else base for name in inner}
    return found & set(modules)


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Modules of one circle, each imported by the next; empty where there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def test_no_import_circles() -> None:
    files = {module_name(path): path for path in product_files()}
    graph = {}
    for name, path in files.items():
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        graph[name] = imported(parse(path), package, files) - {name}
    assert sum(map(len, graph.values())) > 500
    assert circle(graph) == []


def test_the_rule_sees_what_it_looks_for() -> None:
    code = """
from typing import TYPE_CHECKING
import p.a
from p import b, c
if TYPE_CHECKING:
    import p.d
def late():
    from p.e import thing
    from . import f
    from ..q import g
"""
    modules = {"p", "p.a", "p.b", "p.d", "p.e", "r.s.f", "r.q.g"}
    assert imported(ast.parse(code), "r.s", modules) == modules - {"p.d"}
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}})[0] in "abc"
    assert circle({"a": {"b"}, "b": {"c"}, "d": {"a"}}) == []
