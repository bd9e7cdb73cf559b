"""What was compiled here is known by a stamp, and only for this Python, these sources and this processor."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from engine.cli import kernel_progress
from engine.cli.console import Console
from engine.cli.kernel_progress import prepare_kernels
from engine.flows.warmup.kernel_warmup import Work
from engine.kernels import kernel_cache, native_check


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "cache").mkdir()
    monkeypatch.setattr(kernel_cache, "folders", lambda: (tmp_path / "cache",))
    monkeypatch.setattr(kernel_cache, "folder", lambda: tmp_path / "cache")
    monkeypatch.setattr(native_check, "calls_native", lambda: True)
    monkeypatch.setattr(kernel_progress, "_ENGINE", tmp_path / "engine")
    (tmp_path / "engine" / "deep").mkdir(parents=True)
    (tmp_path / "engine" / "deep" / "kernels.py").write_text("x = 1\n")
    return tmp_path / "engine" / "deep" / "kernels.py"


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Works that were made ready."""
    works: list[str] = []

    def warm_up(work: str, progress: object, compiling: object) -> None:
        compiling()  # type: ignore[operator]
        works.append(work)

    monkeypatch.setattr("engine.flows.warmup.kernel_warmup.warm_up", warm_up)
    return works


def prepare(work: Work) -> None:
    prepare_kernels(Console(False), lambda stage, fraction: None, work)


@pytest.mark.usefixtures("sources")
def test_a_work_is_made_ready_once_and_everything_is_every_work(made: list[str]) -> None:
    for work in ("model", "model", "everything", "pictures"):
        prepare(work)  # type: ignore[arg-type]
    assert made == ["model", "everything"]


def test_another_date_processor_or_way_is_another_stamp(
    sources: Path, made: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    prepare("embed")
    for module, name, other in (
        (kernel_cache, "processor", ("another", "+avx")),
        (kernel_cache, "processor", (kernel_cache.processor()[0], "+fewer")),
        (kernel_cache, "compiler", ["0"]),
        (native_check, "calls_native", False),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, lambda other=other: other)
            prepare("embed")
    assert made == ["embed"] * 5
    prepare("embed")
    assert made == ["embed"] * 5
    os.utime(sources, ns=(1, 1))
    prepare("embed")
    assert made == ["embed"] * 6


@pytest.mark.usefixtures("sources")
def test_where_nothing_can_be_kept_every_command_waits_and_says_so(
    made: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    prepare("embed")
    assert "once per machine" in capsys.readouterr().err
    monkeypatch.setattr(kernel_cache, "folder", lambda: None)
    monkeypatch.setattr(kernel_cache, "folders", lambda: ())
    for _ in range(2):
        prepare("model")
        assert "every command" in capsys.readouterr().err
    assert made == ["embed", "model", "model"]
