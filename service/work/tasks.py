"""The tasks by name. Importing this file is cheap; a task brings in what it needs when it is taken."""

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path

from service.work.process import Parent, Reply, Request, Task

__all__ = ["TASKS", "preload"]


def _task(module: str, name: str) -> Task:
    def run(request: Request, folder: Path, progress: Parent) -> Reply:
        reply: Reply = getattr(import_module(f"service.work.{module}"), name)(request, folder, progress)
        return reply

    return run


TASKS: Mapping[str, Task] = {
    "cameras": _task("files", "look_at_cameras"),
    "convert": _task("files", "convert"),
    "dispute": _task("candidates", "settle_dispute"),
    "embed": _task("embedding", "embed_mark"),
    "index": _task("screening", "index"),
    "inspect": _task("files", "inspect"),
    "marks": _task("candidates", "find_marks"),
    "pictures": _task("files", "look_at_pictures"),
    "screen": _task("screening", "screen"),
    "sign": _task("credentials", "sign_model"),
    "verify": _task("verification", "verify_suspect"),
}


def preload(wanted: Callable[[], bool]) -> None:
    """Import what every task needs, and load its compiled kernels: a fork of this process starts at once. Those that
    are not loaded by the time that it is `wanted` are loaded as they are needed; compiling is not broken off."""
    from engine.flows.warmup.kernel_warmup import warm_up
    from service.work import candidates, embedding, files, screening, verification  # noqa: F401

    warm_up("everything", enough=wanted)
