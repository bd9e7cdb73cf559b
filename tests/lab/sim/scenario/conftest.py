"""Renders of suspects are small here, and so is what the mark is shaped on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest

from engine.flows.embed.profiles import PROFILES


@pytest.fixture(autouse=True)
def _small(small_renders: None) -> None:
    """How much renders say is the matter of tests/pipeline."""


@pytest.fixture(scope="module", autouse=True)
def _quick_marks() -> Iterator[None]:
    """Four small views and no landmarks: scenarios name a profile, and what its views give is the matter of
    tests/pipeline."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PROFILES, "fast", replace(PROFILES["fast"], views=4, view_size=256, landmark_views=0))
        yield
