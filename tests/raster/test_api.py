"""The package's surface: what it exports, scratch memory."""

from __future__ import annotations

import numpy as np
import pytest

import engine.raster
from engine.raster import release_memory, workspace
from engine.raster.workspace import borrow_workspace


def test_exports() -> None:
    names = engine.raster.__all__
    assert names == sorted(names, key=lambda name: (not name.isupper(), name))
    assert all(callable(getattr(engine.raster, name)) for name in names if not name.isupper())


def test_workspaces_are_not_shared() -> None:
    release_memory()
    with borrow_workspace() as one, borrow_workspace() as other:
        assert one is not other
        a, b = one.array("x", (100,)), one.array("x", (50,))
        assert np.shares_memory(a, b)
        assert not np.shares_memory(a, other.array("x", (100,)))
        assert one.array("x", (100,), np.int32).dtype == np.int32
    with borrow_workspace() as again:
        assert again is other or again is one


def test_large_workspaces_are_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    release_memory()
    with borrow_workspace() as small:
        small.array("a", (100,))
    with borrow_workspace() as again:
        assert again is small
        monkeypatch.setattr(workspace, "_MOST", again.bytes - 1)
    with borrow_workspace() as other:
        assert other is not small
