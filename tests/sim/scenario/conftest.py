"""Renders of suspects are small here."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def _small(small_renders: None) -> None:
    """How much renders say is the matter of tests/pipeline."""
