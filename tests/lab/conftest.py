"""Tests of the laboratory carry the marker `lab`: `make test` leaves them to `make full`."""

from __future__ import annotations

from pathlib import Path

import pytest

HERE = Path(__file__).parent


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what lies below this folder; the hook sees the whole session's tests."""
    for item in items:
        if HERE in item.path.parents:
            item.add_marker("lab")
