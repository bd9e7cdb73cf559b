"""Images where none can be pulled: each is made of Debian packages and carries the name that the real one has."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.docker.engine import need

BASE = "python:3.11-slim-bookworm"
POSTGRES = "postgres:17-bookworm"
STORE = "mark3dgs-test-store"
RECIPES = Path(__file__).parent / "images"
CERTIFICATES = Path("/etc/ssl/certs/ca-certificates.crt")


@contextmanager
def images(folder: Path) -> Iterator[list[str]]:
    """Have every image that the compose files and the tests need; yields the names of those made here."""
    made: list[str] = []
    try:
        if not _have(BASE):
            _make_base(folder)
            made.append(BASE)
        if not _have(POSTGRES):
            _build(POSTGRES, "postgres.Dockerfile", RECIPES)
            made.append(POSTGRES)
        _build(STORE, "store.Dockerfile", RECIPES)
        made.append(STORE)
        yield made
    finally:
        for name in made:  # a stand-in must not pass for the real one later on
            subprocess.run(["docker", "image", "rm", "--force", name], capture_output=True)


def run(*command: str | Path, timeout: float = 900) -> str:
    """Run a command; its output, or an error that shows it."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=timeout)
    if done.returncode:
        raise RuntimeError(f"{' '.join(map(str, command))}: {done.stdout[-2000:]}\n{done.stderr[-2000:]}")
    return done.stdout


def _have(name: str) -> bool:
    if not subprocess.run(["docker", "image", "inspect", name], capture_output=True).returncode:
        return True
    return not subprocess.run(["docker", "pull", "--quiet", name], capture_output=True).returncode


def _make_base(folder: Path) -> None:
    """Debian with its Python, this machine's certificates and pip settings: what a build here needs to reach out."""
    need("mmdebstrap", "mmdebstrap")
    context = folder / "base"
    context.mkdir()
    run(
        "mmdebstrap",
        "--quiet",
        "--variant=minbase",
        "--include=ca-certificates,python3,python3-venv",
        "bookworm",
        context / "root.tar",
    )
    shutil.copy(CERTIFICATES, context / "ca-certificates.crt")
    settings = Path("/etc/pip.conf")
    (context / "pip.conf").write_text(settings.read_text() if settings.is_file() else "")
    _build(BASE, "base.Dockerfile", context)


def _build(name: str, recipe: str, context: Path) -> None:
    run("docker", "build", "--quiet", "--network=host", f"--tag={name}", f"--file={RECIPES / recipe}", context)
