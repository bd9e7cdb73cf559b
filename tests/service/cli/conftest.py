"""The command, called in this process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import service.cli.app  # noqa: F401  adds the service's commands
from engine.cli.app import run

Mark3dgs = Callable[..., tuple[int, str, str]]


@pytest.fixture
def mark3dgs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Mark3dgs:
    """Call the command with a data folder `data`; exit code and what it said."""

    def call(*arguments: str, **settings: str) -> tuple[int, str, str]:
        for name, value in ({"DATA_DIR": str(tmp_path / "data")} | settings).items():
            monkeypatch.setenv(f"MARK3DGS_{name}", value)
        capfd.readouterr()
        code = run(list(arguments))
        said = capfd.readouterr()
        return code, said.out, said.err

    return call
