"""What the tests install they take away again, and nothing else."""

from __future__ import annotations

import subprocess
from typing import Any

import pytest

from tests.docker import engine


def test_what_was_installed_is_taken_away(monkeypatch: pytest.MonkeyPatch) -> None:
    """A package that was here before, and is only brought up to date, stays."""
    called: list[list[str]] = []

    def run(command: list[str], **_: Any) -> subprocess.CompletedProcess[Any]:
        called.append(command)
        if command[0] == "dpkg-query":
            return subprocess.CompletedProcess(command, 0, b"installed" if command[-1] == "libc6" else b"", b"")
        said = (
            "Inst docker.io (1)\nInst libc6 [1] (2)\nInst runc (1)\nConf runc (1)\n" if "--simulate" in command else ""
        )
        return subprocess.CompletedProcess(command, 0, said, "")

    monkeypatch.setattr(engine, "_added", [])  # what was really installed stays on the list of what is to go
    monkeypatch.setattr(engine.subprocess, "run", run)
    monkeypatch.setattr(engine.os, "geteuid", lambda: 0)
    monkeypatch.setattr(engine.shutil, "which", lambda name: "/usr/bin/" + name if name == "apt-get" else None)
    engine.need("dockerd", "docker.io")
    engine.take_away()
    assert called[-1] == ["apt-get", "--quiet", "--yes", "purge", "docker.io", "runc"]
    count = len(called)
    engine.take_away()
    assert len(called) == count
