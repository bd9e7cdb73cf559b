"""Receivers, and a service of one's own that may reach them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from service.core import Service
from service.settings import Settings
from tests.service.webhooks.receiver import Receiver

Receivers = Callable[..., Receiver]


@pytest.fixture
def receivers() -> Iterator[Receivers]:
    """Makes receivers."""
    made: list[Receiver] = []

    def make(*given: Any) -> Receiver:
        made.append(Receiver(*given))
        return made[-1]

    yield make
    for each in made:
        each.close()


@pytest.fixture
def own(tmp_path: Path) -> Iterator[Service]:
    """A service whose operator lets webhooks go to this machine."""
    service = Service.open(Settings(data_dir=tmp_path / "data", webhooks_private=True))
    yield service
    service.close()
