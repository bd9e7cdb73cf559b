"""One task, now, for a handler that must answer soon: a fresh process, and none kept ready."""

import secrets
import shutil
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from service.jobs.child import COMMAND, Children, Limits
from service.jobs.port import Cancelled
from service.settings import Settings

AT_ONCE = 2
"""Such tasks run beside the workers' on the same cores: few at a time, the others wait."""

_turn = threading.BoundedSemaphore(AT_ONCE)


class _Single(Children):
    def prepare(self) -> None:
        """Nothing is kept ready: an API process stays small."""


@contextmanager
def task_folder(settings: Settings) -> Iterator[Path]:
    """An empty scratch folder for one task, removed after it."""
    folder = settings.scratch / secrets.token_hex(12)
    folder.mkdir(parents=True)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def run_once(
    settings: Settings, task: str, request: Mapping[str, Any], folder: Path, seconds: float
) -> dict[str, Any] | None:
    """The reply of a task, or None where it took longer than `seconds`."""
    limits = Limits(settings.child_memory_bytes, settings.child_cpu_seconds, settings.child_file_bytes)
    until = time.monotonic() + seconds
    if not _turn.acquire(timeout=seconds):
        return None
    try:
        return _Single(limits, (*COMMAND, "--prompt")).run(
            task, request, folder, lambda stage, fraction: time.monotonic() < until
        )
    except Cancelled:
        return None
    finally:
        _turn.release()
