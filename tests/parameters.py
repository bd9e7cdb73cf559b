"""Long lists of parameters, of which `make test` plays a few and `make full` all."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def few(kept: Iterable[Any], values: Iterable[Any]) -> list[Any]:
    """The values of a parametrization, marked `long` but for those kept; ValueError if one to be kept is not there."""
    kept, values = list(kept), list(values)
    if strange := [each for each in kept if each not in values]:
        raise ValueError(f"not among the parameters: {strange}")
    return [
        each if each in kept else pytest.param(*(each if isinstance(each, tuple) else (each,)), marks=pytest.mark.long)
        for each in values
    ]
