"""What was compiled here is known by a stamp, and only for this Python, these sources and this processor."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from engine.cli.console import Console
from engine.cli.kernel_progress import prepare_kernels
from engine.kernels import machine_code as native
from engine.kernels import stamp as kernel_stamp
from engine.kernels.stamp import is_stamped, stamp


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setattr(kernel_stamp, "store", lambda: tmp_path / "cache")
    monkeypatch.setattr(kernel_stamp, "_ENGINE", tmp_path / "engine")
    (tmp_path / "engine" / "deep").mkdir(parents=True)
    (tmp_path / "engine" / "deep" / "kernels.py").write_text("x = 1\n")
    return tmp_path / "engine" / "deep" / "kernels.py"


def test_a_stamp_is_of_its_work_and_of_everything(sources: Path) -> None:
    assert not is_stamped("embed")
    stamp("embed")
    assert is_stamped("embed")
    assert not is_stamped("model")
    stamp("everything")
    assert is_stamped("model")


def test_another_date_or_processor_is_another_stamp(sources: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stamp("embed")
    with monkeypatch.context() as other:
        other.setattr(kernel_stamp, "processor", lambda: ("another", native.processor()[1]))
        assert not is_stamped("embed")
    with monkeypatch.context() as other:
        other.setattr(kernel_stamp, "processor", lambda: (native.processor()[0], "+fewer"))
        assert not is_stamped("embed")
    assert is_stamped("embed")
    os.utime(sources, ns=(1, 1))
    assert not is_stamped("embed")


@pytest.mark.usefixtures("sources")
def test_where_nothing_can_be_written_nothing_is_said(tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("a file where a folder should be")
    stamp("embed")
    assert not is_stamped("embed")


@pytest.mark.usefixtures("sources")
def test_the_command_line_makes_ready_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []
    monkeypatch.setattr("engine.flows.warmup.kernel_warmup.warm_up", lambda work, *_, **__: made.append(work))
    for _ in range(2):
        prepare_kernels(Console(True), lambda stage, fraction: None, "model")
    assert made == ["model"]
