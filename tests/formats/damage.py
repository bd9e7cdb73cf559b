"""Files that were cut or changed: a reader gives an error of ours or a sound model, in little memory."""

from __future__ import annotations

import copy
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from hypothesis import strategies as st

from engine.errors import FormatError
from engine.model import GaussianModel
from tests.formats.models import ATTRIBUTES

Read = Callable[..., tuple[GaussianModel, Any]]
"""A reader of bytes, which takes the name of the `file`."""

MUTATIONS = st.lists(st.tuples(st.integers(0, 1 << 20), st.integers(0, 255)), min_size=1, max_size=6)
"""Positions, and the bytes to put there."""
JUNK = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**60), 2**60), st.floats(), st.text(max_size=5), st.just([]), st.just({})
)


def mutated(data: bytes, mutations: list[tuple[int, int]]) -> bytes:
    result = bytearray(data)
    for position, value in mutations:
        result[position % len(result)] = value
    return bytes(result)


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of everything in a JSON value."""
    keys = value.keys() if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    return [path, *(each for key in keys for each in places(value[key], (*path, key)))]


def with_value(parsed: Any, path: tuple[Any, ...], value: Any) -> Any:
    """A copy of a JSON value with another value at a place."""
    parsed = copy.deepcopy(parsed)
    inner = parsed
    for step in path[:-1]:
        inner = inner[step]
    inner[path[-1]] = value
    return parsed


def assert_valid(model: GaussianModel) -> None:
    for name in ATTRIBUTES:
        assert np.isfinite(getattr(model, name)).all(), name
    assert np.allclose(np.linalg.norm(model.quats, axis=1), 1.0, atol=1e-5)


def survives(read: Read, data: bytes) -> None:
    try:
        model, _ = read(data, file="x")
    except FormatError:
        return
    assert_valid(model)


@contextmanager
def little_memory(most: float) -> Iterator[None]:
    """Whether what happens inside takes fewer bytes."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()
