"""The log stays short whatever happens how often."""

from __future__ import annotations

import logging

import pytest

from service.cli import log


def test_what_repeats_is_counted_and_what_does_not_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: written.append(record.getMessage())  # type: ignore[method-assign]
    handler.addFilter(log.Repeats())
    logger = logging.Logger("a")
    logger.addHandler(handler)
    clock = [1000.0]
    monkeypatch.setattr(logging.time, "time", lambda: clock[0])  # type: ignore[attr-defined]

    def often() -> None:
        logger.warning("accept %s", "failed")

    for _ in range(5000):
        often()
    logger.warning("another")
    assert written == ["accept failed"] * log.MOST + ["another"]
    clock[0] += log.SECONDS
    often()
    often()
    assert written[-2:] == ["accept failed (4980 more were left out before)", "accept failed"]
