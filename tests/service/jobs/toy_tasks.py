"""Tasks that need no engine, and the process that serves them: `python -m tests.service.jobs.toy_tasks`."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from service.work.process import Parent, Progress, serve

Request = Mapping[str, Any]


def echo(request: Request, folder: Path, progress: Progress) -> dict[str, Any]:
    progress("echoing", 0.5)
    (folder / "file").write_text("made")
    return {"request": dict(request), "pid": os.getpid(), "parent": os.getppid(), "nice": os.nice(0)}


def chat(request: Request, folder: Path, progress: Progress) -> dict[str, Any]:
    print("a stray line")  # noqa: T201
    os.system("echo a line of a library in C")
    sys.stdout.write('{"reply": {"said": "the wrong thing"}}\n')
    return {"said": "the right thing"}


def ask(request: Request, folder: Path, progress: Parent) -> dict[str, Any]:
    return {"answers": [progress.ask(question) for question in request["questions"]]}


def nap(request: Request, folder: Path, progress: Progress) -> dict[str, Any]:
    Path(request["pid_file"]).write_text(str(os.getpid()))
    time.sleep(request.get("seconds", 60))
    return {}


def allocate(request: Request, folder: Path, progress: Progress) -> dict[str, Any]:
    return {"length": len(bytes(request["bytes"]))}


def spin(request: Request, folder: Path, progress: Progress) -> dict[str, Any]:
    while True:
        pass


def write(request: Request, folder: Path, progress: Progress) -> dict[str, Any]:
    (folder / "big").write_bytes(bytes(request["bytes"]))
    return {}


def die(request: Request, folder: Path, progress: Progress) -> dict[str, Any]:
    os.kill(os.getpid(), signal.Signals[request["signal"]])
    time.sleep(60)
    return {}


def die_once(request: Request, folder: Path, progress: Progress) -> dict[str, Any]:
    """Killed from outside, as it were, the first time it runs."""
    marker = Path(request["marker"])
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return {"ran": "again"}


def leave(request: Request, folder: Path, progress: Progress) -> dict[str, Any]:
    os._exit(0)


def environment(request: Request, folder: Path, progress: Progress) -> dict[str, Any]:
    return dict(os.environ)


def fail(request: Request, folder: Path, progress: Progress) -> dict[str, Any]:
    import engine.errors
    import service.problems

    name, kwargs = request["error"], request["arguments"]
    for module in (engine.errors, service.problems):
        if hasattr(module, name):
            raise getattr(module, name)(*kwargs.pop("args", []), **kwargs)
    raise getattr(__builtins__, name, RuntimeError)(*kwargs.pop("args", []))


TASKS = {f.__name__: f for f in (allocate, ask, chat, die, die_once, echo, environment, fail, leave, nap, spin, write)}


def until_wanted(wanted: Callable[[], bool]) -> None:
    """Has never loaded everything, and is not waited for."""
    while not wanted():
        time.sleep(0.005)


if __name__ == "__main__":
    serve(TASKS, until_wanted)
