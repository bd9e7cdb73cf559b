"""The tasks by name. Importing this file is cheap; `preload` brings in what the tasks will need."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from service.work.process import Progress, Task

__all__ = ["TASKS", "preload"]


def inspect(request: Mapping[str, Any], folder: Path, progress: Progress) -> dict[str, Any]:
    """See `service.work.inspection`."""
    from service.work.inspection import inspect_upload

    return inspect_upload(request, folder, progress)


def embed(request: Mapping[str, Any], folder: Path, progress: Progress) -> dict[str, Any]:
    """See `service.work.embedding`."""
    from service.work.embedding import embed_mark

    return embed_mark(request, folder, progress)


def verify(request: Mapping[str, Any], folder: Path, progress: Progress) -> dict[str, Any]:
    """See `service.work.verification`."""
    from service.work.verification import verify_suspect

    return verify_suspect(request, folder, progress)


def convert(request: Mapping[str, Any], folder: Path, progress: Progress) -> dict[str, Any]:
    """See `service.work.conversion`."""
    from service.work.conversion import convert_model

    return convert_model(request, folder, progress)


def picture(request: Mapping[str, Any], folder: Path, progress: Progress) -> dict[str, Any]:
    """See `service.work.looking`."""
    from service.work.looking import look_at_picture

    return look_at_picture(request, folder, progress)


def cameras(request: Mapping[str, Any], folder: Path, progress: Progress) -> dict[str, Any]:
    """See `service.work.looking`."""
    from service.work.looking import look_at_cameras

    return look_at_cameras(request, folder, progress)


TASKS: Mapping[str, Task] = {
    "cameras": cameras,
    "convert": convert,
    "embed": embed,
    "inspect": inspect,
    "picture": picture,
    "verify": verify,
}


def preload() -> None:
    """Import what every task needs, and load its compiled kernels: a process in waiting starts at once."""
    from engine.pipeline.warming import warm_up
    from service.work import conversion, embedding, inspection, verification  # noqa: F401

    warm_up("everything")
