"""A Docker engine to test with: the one that answers, or Debian's own, started here with a folder of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

START_SECONDS = 60
_added: list[str] = []
"""Packages that were not here before."""


@contextmanager
def docker_engine() -> Iterator[None]:
    """An engine that `docker` and `docker-compose` reach as they are called; skips where none can be had."""
    if shutil.which("docker") and _answers():
        yield
        return
    if sys.platform != "linux" or os.geteuid() != 0:
        pytest.skip("no Docker engine answers, and starting one takes root on Linux")
    if not shutil.which("dockerd"):
        _install("docker.io")
    folder = Path(tempfile.mkdtemp(prefix="mark3dgs-docker-"))
    before = os.environ.get("DOCKER_HOST")
    os.environ["DOCKER_HOST"] = f"unix://{folder}/docker.sock"
    with (folder / "dockerd.log").open("wb") as log:
        command = ["dockerd", f"--host=unix://{folder}/docker.sock", f"--data-root={folder}/data"]
        command += [f"--exec-root={folder}/exec", f"--pidfile={folder}/docker.pid"]
        daemon = subprocess.Popen(command, stdout=log, stderr=log, stdin=subprocess.DEVNULL)
    try:
        until = time.monotonic() + START_SECONDS
        while not _answers():
            if daemon.poll() is not None or time.monotonic() > until:
                tail = (folder / "dockerd.log").read_text(errors="replace")[-500:]
                pytest.skip(f"the Docker engine does not start on this machine: {tail}")
            time.sleep(0.3)
        yield
    finally:
        daemon.terminate()
        daemon.wait(60)
        if before is None:
            del os.environ["DOCKER_HOST"]
        else:
            os.environ["DOCKER_HOST"] = before
        # The engine leaves its network's name space mounted.
        for mount in (folder / "exec" / "netns").glob("*"):
            subprocess.run(["umount", mount], capture_output=True)
        shutil.rmtree(folder)


def need(program: str, package: str) -> None:
    """Have a program of a Debian package, or skip."""
    if not shutil.which(program):
        _install(package)


def _answers() -> bool:
    try:
        return subprocess.run(["docker", "version"], capture_output=True, timeout=20).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


def _install(package: str) -> None:
    if os.geteuid() != 0 or not shutil.which("apt-get"):
        pytest.skip(f"the package {package} is not installed, and installing it takes root on Debian")
    install = ["install", "--no-install-recommends", package]
    _apt("update")
    coming = [line.split()[1] for line in _apt("--simulate", *install).splitlines() if line.startswith("Inst ")]
    new = [name for name in coming if not _is_installed(name)]  # others are only brought up to date
    _added.extend(new)  # before, so that half an installation is taken away, too
    _apt("--yes", *install)


def take_away() -> None:
    """Remove the packages that were installed for the tests, and no others."""
    if _added:
        _apt("--yes", "purge", *_added)
        _added.clear()


def _is_installed(package: str) -> bool:
    done = subprocess.run(["dpkg-query", "--show", "--showformat=${db:Status-Status}", package], capture_output=True)
    return done.stdout == b"installed"


def _apt(*arguments: str) -> str:
    done = subprocess.run(["apt-get", "--quiet", *arguments], capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"apt-get {' '.join(arguments)} failed: {done.stderr[-300:]}")
    return done.stdout
