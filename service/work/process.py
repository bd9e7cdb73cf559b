"""The process side of one task: a request on standard input, JSON lines on standard output, then the end.

Standard input stays open as long as the parent lives; when it ends, so does a task, whatever it is doing.

What went wrong is reported to the parent as a kind of `service.problems`, a text and its numbers.
"""

import errno
import json
import logging
import os
import queue
import resource
import select
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path, PurePath, PurePosixPath
from typing import Any, Protocol, TextIO

from engine.errors import CameraError, CapacityError, FormatError, InputError, KeyFileError
from engine.numerics.plain import Json
from service.problems import Problem

Progress = Callable[[str, float], None]


class Parent(Protocol):
    """The process that started the task: it takes progress and answers questions."""

    def __call__(self, stage: str, fraction: float) -> None:
        """Progress."""

    def ask(self, question: str) -> str:
        """The answer to a question of the task's contract; waits for it."""


Request = Mapping[str, Any]
"""A task's request, as its JSON came."""
Reply = Json
"""And its reply, as its JSON goes."""
Task = Callable[[Request, Path, Parent], Reply]

NICENESS = 5
"""Below the API and the database: they must answer while every core works on a model."""

PROMPT = "--prompt"
"""On the command line: a user waits for this answer, which takes a second, so its priority is not lowered."""

SECONDS_BETWEEN_LINES = 0.1
"""Progress of one stage is said no more often than this."""

PATIENCE_SECONDS = 0.05
"""A request that is there when the process starts is read within this time; else the process is one in waiting."""

FORKS = sys.platform == "linux"
"""Elsewhere system libraries may hang in a forked process."""

_log = logging.getLogger(__name__)


def serve(tasks: Mapping[str, Task], warm_up: Callable[[Callable[[], bool]], None]) -> None:
    """Do one task, and end the process. Where no request is there yet, `warm_up` makes ready what can be; it is given a
    function that says whether a request has come by now, which needs only some of that. What is ready then does no task
    itself: each is done by a fork of it."""
    out = _take_standard_output()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # a core would hold the owner's key
    if PROMPT not in sys.argv:
        os.nice(NICENESS)
    # No spare is kept for a user who waits: on a busy machine its request may come late, and is all it is to do.
    if PROMPT not in sys.argv and not _request_within(PATIENCE_SECONDS):
        out.write(json.dumps({"stage": "compile", "fraction": 0.0}) + "\n")  # read by who comes before it is done
        out.flush()
        try:
            warm_up(lambda: _request_within(0))
        except Exception:
            _log.exception("the warm-up failed; the task starts cold")
        if FORKS:
            _fork_for_each_request(out)
    requests: queue.Queue[bytes] = queue.Queue()
    threading.Thread(target=_listen, args=(requests,), daemon=True).start()
    line = requests.get()
    answer = _do(json.loads(line), tasks, _Lines(out, requests))
    out.write(json.dumps(answer) + "\n")
    out.flush()
    os._exit(0)  # nothing is left to tidy up, and tearing down the libraries takes half a second


def _request_within(seconds: float | None) -> bool:
    """Whether a request waits, which is left unread; None waits for one. Ends the process where the parent is gone."""
    poll = select.poll()
    poll.register(0, select.POLLIN)
    events = poll.poll(None if seconds is None else 1000 * seconds)
    if events and not events[0][1] & select.POLLIN:
        os._exit(1)
    return bool(events)


def _fork_for_each_request(out: TextIO) -> None:
    """Returns in a fork of this process, one for each request, which the fork reads: what is secret in it never comes
    here. How the fork ended is said to the parent, who then may send the next request."""
    while _request_within(None):
        fork = os.fork()
        if not fork:
            return
        ended = os.waitstatus_to_exitcode(os.waitpid(fork, 0)[1])
        with suppress(BrokenPipeError):  # the parent is gone, which the next look finds
            out.write(json.dumps({"ended": ended}) + "\n")
            out.flush()


class _Lines:
    """Progress and questions, as lines of JSON; answers come where the request came from."""

    def __init__(self, out: TextIO, answers: queue.Queue[bytes]) -> None:
        self._out, self._answers, self._stage, self._at = out, answers, "", 0.0

    def __call__(self, stage: str, fraction: float) -> None:
        now = time.monotonic()
        if stage == self._stage and fraction < 1 and now - self._at < SECONDS_BETWEEN_LINES:
            return
        self._stage, self._at = stage, now
        self._say({"stage": stage, "fraction": min(1.0, max(0.0, float(fraction)))})

    def ask(self, question: str) -> str:
        self._say({"ask": question})
        return str(json.loads(self._answers.get())["answer"])

    def _say(self, line: Json) -> None:
        self._out.write(json.dumps(line) + "\n")
        self._out.flush()


def _do(envelope: Json, tasks: Mapping[str, Task], progress: Parent) -> Json:
    request, folder = envelope["request"], Path(envelope["folder"])
    os.environ["TMPDIR"] = tempfile.tempdir = str(folder)  # what libraries put aside goes with the folder
    try:
        _limit(envelope["limits"])
        return {"reply": tasks[envelope["task"]](request, folder, progress)}
    except Exception as error:
        failure = describe(error, request)
        if failure["kind"] == "internal":
            _log.exception("task %s failed", envelope["task"])
        return {"error": failure}


def _limit(limits: Mapping[str, int]) -> None:
    used = resource.getrusage(resource.RUSAGE_SELF)
    cpu = limits["cpu_seconds"] + int(used.ru_utime + used.ru_stime) + 1
    for kind, soft, hard in (
        (resource.RLIMIT_AS, limits["memory_bytes"], limits["memory_bytes"]),
        (resource.RLIMIT_FSIZE, limits["file_bytes"], limits["file_bytes"]),
        (resource.RLIMIT_CPU, cpu, cpu + 1),
    ):
        ceiling = resource.getrlimit(kind)[1]
        if ceiling != resource.RLIM_INFINITY:  # the machine's own limit may be lower, and cannot be raised
            soft, hard = min(soft, ceiling), min(hard, ceiling)
        resource.setrlimit(kind, (soft, hard))


def _take_standard_output() -> TextIO:
    """The pipe to the parent, for us alone: what libraries print goes to standard error."""
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    return out


def _listen(requests: queue.Queue[bytes]) -> None:
    # Read by system calls: a buffered reader would hold its lock while the interpreter shuts down.
    pending = b""
    while chunk := os.read(0, 1 << 16):
        pending += chunk
        line, newline, rest = pending.partition(b"\n")
        if newline:
            requests.put(line)
            pending = rest
    os._exit(1)


_ALLOCATION_FAILED = ("can't allocate memory", "insufficient memory", "allocation failed")
"""As torch, OpenCV and numba say it, none of them with a MemoryError."""


def describe(error: BaseException, request: Mapping[str, Any] | None = None) -> Json:
    """`kind`, `detail` and further members of an error.

    Paths that the request named are cut down to their last part: where this machine keeps its files is no business
    of the client's.
    """
    plain = _describe(error)
    if isinstance(error, FormatError):  # its message goes on from the name of the file
        plain["detail"] = f"{name_of(request or {})}: {plain['detail']}"
    for path in sorted(_paths(request or {}), key=len, reverse=True):
        plain["detail"] = plain["detail"].replace(path, PurePath(path).name)
    return plain


def name_of(request: Request) -> str:
    """What a request's model is called by its sender, without folders and control characters: some formats are known
    by their ending alone. "the model" where it has no name."""
    name = PurePosixPath(str(request.get("name") or "").replace("\\", "/")).name
    return "".join(letter for letter in name if letter.isprintable())[-200:] or "the model"


def _describe(error: BaseException) -> Json:
    text = " ".join(str(error).split())
    if isinstance(error, Problem):
        return {"kind": error.kind, "detail": error.detail, **error.extra}
    if isinstance(error, FormatError):
        place = {"element": error.element, "row": error.row, "property": error.prop}
        known = {name: value for name, value in place.items() if value is not None}
        where = ", ".join(f"{name} {value!r}" for name, value in known.items())
        return {"kind": "unreadable-model", "detail": f"{where}: {error.message}" if where else error.message, **known}
    if isinstance(error, CameraError):
        return {"kind": "unreadable-cameras", "detail": text}
    if isinstance(error, CapacityError):
        return {"kind": "capacity", "detail": text, "wanted": error.wanted, "capacity": error.capacity}
    if isinstance(error, (InputError, KeyFileError)):
        return {"kind": "invalid-request", "detail": text}
    if isinstance(error, MemoryError) or any(sign in text.lower() for sign in _ALLOCATION_FAILED):
        return {"kind": "engine-limit", "detail": "the work needed more memory than it may have"}
    if isinstance(error, OSError) and error.errno == errno.EFBIG:
        return {"kind": "engine-limit", "detail": "the work wrote a larger file than it may"}
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        return {"kind": "storage-full", "detail": "no space left for the files of this work"}
    return {"kind": "internal", "detail": f"the work failed by a fault of this service ({type(error).__name__})"}


def _paths(value: Any) -> Iterator[str]:
    if isinstance(value, str) and value.startswith("/") and len(value) > 1:
        yield value
    elif isinstance(value, (Mapping, list, tuple)):
        for item in value.values() if isinstance(value, Mapping) else value:
            yield from _paths(item)
