"""What is begun while modules load is there when needed, or its error is."""

from __future__ import annotations

import os
import threading

import pytest

from engine.cli import app
from engine.errors import FormatError
from engine.usecases.read_ahead import ahead


def test_it_is_begun_at_once_and_given_when_asked_for() -> None:
    begun = threading.Event()

    def work(x: int, *, more: int) -> int:
        begun.set()
        return x + more

    answer = ahead(work, 1, more=2)
    assert begun.wait(10.0)
    assert answer.result() == 3


def test_its_error_is_raised_where_it_is_asked_for() -> None:
    def work() -> int:
        raise FormatError("is no model", file="x")

    answer = ahead(work)
    with pytest.raises(FormatError, match="is no model"):
        answer.result()


def test_a_command_that_ends_before_does_not_wait_for_it() -> None:
    held = threading.Event()
    before = set(threading.enumerate())
    answer = ahead(held.wait)
    (started,) = set(threading.enumerate()) - before
    assert started.daemon
    held.set()
    assert answer.result()


def test_the_command_keeps_what_it_freed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before anything large is made."""
    order: list[str] = []
    monkeypatch.setattr(app, "keep_freed_memory", lambda: order.append("kept"))
    monkeypatch.setattr(app, "run", lambda arguments: order.append("run") or 0)
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    with pytest.raises(SystemExit):
        app.main()
    assert order == ["kept", "run"]
    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
