"""Which distributions the core needs, and under which names they are imported."""

from __future__ import annotations

import re
import tomllib
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, requires

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.architecture.tree import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


@cache
def closure(*extras: str) -> frozenset[str]:
    """Distributions that the core and these extras need here, those that others of them need included."""
    wanted = [*PROJECT["dependencies"], *(line for e in extras for line in PROJECT["optional-dependencies"][e])]
    found: set[str] = set()
    waiting = [(Requirement(line), frozenset[str]()) for line in wanted]
    while waiting:
        requirement, chosen = waiting.pop()
        name = canonicalize_name(requirement.name)
        if requirement.marker is not None and not any(requirement.marker.evaluate({"extra": e}) for e in chosen | {""}):
            continue
        if name in found and not requirement.extras:
            continue
        found.add(name)
        try:
            below = requires(name) or []
        except PackageNotFoundError:
            continue
        waiting += [(Requirement(line), frozenset(requirement.extras)) for line in below]
    return frozenset(found)


@cache
def import_names(names: frozenset[str]) -> set[str]:
    """Top-level names that these distributions bring, where they are installed."""
    return {
        module for module, homes in packages_distributions().items() if names & {canonicalize_name(h) for h in homes}
    }


def beyond_the_core() -> list[str]:
    """Top-level names of everything installed here that the core does not need."""
    ours = {"engine", "service", "mark3dgs", "tests"}
    return sorted(name for name in set(packages_distributions()) - import_names(closure()) - ours if _is_module(name))


def _is_module(name: str) -> bool:
    return re.fullmatch(r"[A-Za-z_]\w*", name) is not None
