"""Tasks of `service.work` in processes of their own, with limits; one stands ready, of which they are forked."""

from __future__ import annotations

import itertools
import json
import logging
import os
import queue
import secrets
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from service.problems import KINDS, Problem
from service.settings import Settings

COMMAND = (sys.executable, "-m", "service.work")

SECONDS_BETWEEN_LOOKS = 0.35
"""How often the job's row is looked at and written while a task runs: a cancelled task dies within this time."""

AT_ONCE = 2
"""Tasks for handlers that run next to the workers' on the same cores: few at a time, tenants take turns."""

MAX_LINE_BYTES = 64 << 20
_GOODBYE_SECONDS = 5.0

# A process that reads hostile files is handed no master key, no database and no cloud credentials.
_ENVIRONMENT = {"HOME", "LANG", "LD_LIBRARY_PATH", "MPLCONFIGDIR", "PATH", "TMPDIR", "TZ", "VIRTUAL_ENV"}
_PREFIXES = ("CUDA_", "KMP_", "LC_", "MKL_", "NUMBA_", "OMP_", "OPENBLAS_", "PYTHON", "TORCH", "XDG_")

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Limits:
    """What one task may use."""

    memory_bytes: int  # of address space
    cpu_seconds: int  # of all its threads
    file_bytes: int  # of its largest file

    @classmethod
    def of(cls, settings: Settings) -> Limits:
        """What the operator allows."""
        return cls(settings.child_memory_bytes, settings.child_cpu_seconds, settings.child_file_bytes)

    @property
    def seconds(self) -> int:
        """By the clock: a task that neither works nor answers for that long hangs."""
        return 2 * self.cpu_seconds + 60


Answer = Callable[[str], str]
"""Answers what a task asks while it runs."""
Reply = dict[str, Any]
"""What a task of `service.work` replies: JSON values, by names that the task's docstring has."""


class Cancelled(Exception):
    """The task was cancelled; its process was ended."""


class Stopped(Exception):
    """This worker is being shut down; the task was killed and is to be done again elsewhere."""


class _Process:
    """A process that does a task, or forks one for each, and what it says."""

    def __init__(self, popen: subprocess.Popen[bytes]) -> None:
        assert popen.stdin is not None
        assert popen.stdout is not None  # both are opened as pipes
        self.popen, self._requests, self._answers = popen, popen.stdin, popen.stdout
        self.lines = queue.Queue[bytes]()
        self.reusable = False  # its fork answered and is gone
        threading.Thread(target=self._read, daemon=True).start()

    def tell(self, line: bytes) -> None:
        """BrokenPipeError where it is gone."""
        self._requests.write(line)
        self._requests.flush()

    def kill(self) -> None:
        """With all it started."""
        if self.popen.returncode is None:  # once reaped, its number may be another's
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self.popen.pid, signal.SIGKILL)

    def close(self) -> None:
        """Kill it and wait for its end."""
        self.kill()
        self.popen.wait()
        for pipe in (self._requests, self._answers):
            with suppress(OSError):
                pipe.close()

    def _read(self) -> None:
        """Lines of the process; an empty one is the end."""
        with suppress(OSError, ValueError):  # closed under our hands once the process is done with
            while line := self._answers.readline(MAX_LINE_BYTES):
                self.lines.put(line)
        self.lines.put(b"")


class Children:
    """Runs tasks one after another, each in a fresh process: one that `command` starts, or a fork of it once it has
    everything loaded."""

    def __init__(self, limits: Limits, command: Sequence[str] = COMMAND) -> None:
        self._limits, self._command = limits, tuple(command)
        self._lock = threading.Lock()
        self._spare: _Process | None = None
        self._running: _Process | None = None
        self._stopped = False

    def prepare(self) -> None:
        """Have a process ready for the next task; imports and kernels are loaded in idle time."""
        with self._lock:
            if not self._stopped and (self._spare is None or self._spare.popen.poll() is not None):
                try:
                    self._spare = self._start()
                except OSError as error:  # the next task reports it, if it is still true then
                    _log.warning("no process could be made ready: %s", error)
                    self._spare = None

    def run(
        self,
        task: str,
        request: Mapping[str, Any],
        folder: Path,
        go_on: Callable[[str, float], bool] = lambda stage, fraction: True,
        answer: Answer | None = None,
    ) -> Reply:
        """Do a task and return its reply; its files lie in `folder`. A request, with its secrets, goes through a pipe.

        `go_on` is called with stage and fraction about three times a second, changed or not; False ends the task with
        `Cancelled`. `answer` answers what the task asks. Raises `Stopped` after `stop`, and the `Problem` that the task
        replied, or engine-limit where the process died.
        """
        limits = asdict(self._limits)
        envelope = {"task": task, "request": request, "folder": str(folder), "limits": limits}
        line = json.dumps(envelope).encode() + b"\n"
        try:
            process = self._take(line)
            return self._follow(process, go_on, answer)
        finally:
            self._end_running()
            self.prepare()

    def stop(self) -> None:
        """Kill what runs and what stands ready, for good."""
        with self._lock:
            self._stopped = True
            for process in (self._running, self._spare):
                if process is not None:
                    process.kill()

    def _take(self, line: bytes) -> _Process:
        """The spare process or a new one, with the request sent."""
        while True:
            with self._lock:
                if self._stopped:
                    raise Stopped
                fresh = self._spare is None
                process = self._running = self._start() if self._spare is None else self._spare
                self._spare, process.reusable = None, False
            try:
                process.tell(line)
                return process
            except BrokenPipeError:
                process.kill()
                if fresh:
                    return process  # it died of itself; `_follow` says of what
                # The spare had died while it waited, which is no fault of this task; take a new one.

    def _follow(self, process: _Process, go_on: Callable[[str, float], bool], answer: Answer | None) -> Reply:
        started = looked = time.monotonic()
        stage, fraction = "", 0.0
        while True:
            with suppress(queue.Empty):
                line = process.lines.get(timeout=max(0.0, looked + SECONDS_BETWEEN_LOOKS - time.monotonic()))
                said: dict[str, Any] = _parse(line) if line else {"ended": None}
                if "reply" in said or "error" in said:
                    process.reusable = _ended_well(process)
                if "reply" in said:
                    return dict(said["reply"])
                if "error" in said:
                    raise _problem(said["error"])
                if "ended" in said:
                    raise self._death(process, said["ended"])
                if "ask" in said:
                    _tell(process, answer, str(said["ask"]))
                else:
                    stage, fraction = str(said["stage"]), float(said["fraction"])
            now = time.monotonic()
            if now - looked >= SECONDS_BETWEEN_LOOKS:
                looked = now
                if not go_on(stage, fraction):
                    raise Cancelled
                if now - started > self._limits.seconds:
                    raise Problem("engine-limit", f"the work gave no result within {self._limits.seconds} s")

    def _death(self, process: _Process, code: int | None) -> Exception:
        """Why a process ended without an answer, with this status, or its own where it said none."""
        if code is None:
            with suppress(subprocess.TimeoutExpired):
                code = process.popen.wait(_GOODBYE_SECONDS)
        if self._stopped:
            return Stopped()
        if code is not None and code < 0:
            name = signal.Signals(-code).name
            if name == "SIGXCPU":
                seconds = self._limits.cpu_seconds
                return Problem("engine-limit", f"the work used up its {seconds} s of CPU time")
            hint = "; the machine may be out of memory" if name == "SIGKILL" else ""
            return Problem("engine-limit", f"the work was ended by {name}{hint}", signal=name)
        _log.error("a task's process ended with status %s and without an answer", code)
        return Problem("internal", "the work ended without an answer")

    def _end_running(self) -> None:
        with self._lock:
            process, self._running = self._running, None
            if process is not None and process.reusable and not self._stopped:
                self._spare, process = process, None
        if process is not None:
            process.close()

    def _start(self) -> _Process:
        environment = {
            name: value for name, value in os.environ.items() if name in _ENVIRONMENT or name.startswith(_PREFIXES)
        }
        return _Process(
            subprocess.Popen(
                self._command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env=environment,
                start_new_session=True,  # a group of its own, killed as one
            )
        )


class Turns:
    """`at_once` callers at a time, whose tenant has the fewest at work first; the others wait in their threads."""

    def __init__(self, at_once: int) -> None:
        self._at_once = at_once
        self._numbers = itertools.count()
        self._waiting: set[tuple[int, str]] = set()  # number of coming, tenant
        self._at_work: Counter[str] = Counter()
        self._changed = threading.Condition()

    @contextmanager
    def of(self, tenant: str) -> Iterator[None]:
        """Wait for a turn of this tenant's, and have it."""
        me = (next(self._numbers), tenant)
        with self._changed:
            self._waiting.add(me)
            self._changed.wait_for(lambda: self._next() == me)
            self._waiting.remove(me)
            self._at_work[tenant] += 1
            self._changed.notify_all()
        try:
            yield
        finally:
            with self._changed:
                self._at_work -= Counter([tenant])  # drops who has none left
                self._changed.notify_all()

    def _next(self) -> tuple[int, str] | None:
        if self._at_work.total() >= self._at_once:
            return None
        return min(self._waiting, key=lambda each: (self._at_work[each[1]], each[0]))


_turns = Turns(AT_ONCE)


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
    settings: Settings, task: str, request: Mapping[str, Any], folder: Path, seconds: float, tenant: str
) -> Reply | None:
    """The reply of a task, for a handler that must answer soon, or None where it took longer than `seconds`.

    How long it waits for its turn does not count: what is judged then would depend on what others do.
    """
    with _turns.of(tenant):
        until = time.monotonic() + seconds
        try:
            return _Single(Limits.of(settings), (*COMMAND, "--prompt")).run(
                task, request, folder, lambda stage, fraction: time.monotonic() < until
            )
        except Cancelled:
            return None


def run_within(
    settings: Settings, task: str, request: Mapping[str, Any], folder: Path, seconds: float, tenant: str, what: str
) -> Reply:
    """As `run_once`; unavailable, as `what` took too long, where there is no reply in time."""
    reply = run_once(settings, task, request, folder, seconds, tenant)
    if reply is None:
        raise Problem("unavailable", f"{what} took over {seconds:.0f} s", headers={"Retry-After": "60"})
    return reply


def _ended_well(process: _Process) -> bool:
    """Whether a fork that answered is gone as it should be, so that the next request is read by the next one."""
    try:
        return bool(json.loads(process.lines.get(timeout=_GOODBYE_SECONDS)) == {"ended": 0})
    except (queue.Empty, ValueError):
        return False


def _parse(line: bytes) -> dict[str, Any]:
    try:
        said = json.loads(line)
        ends = {"reply", "error", "ask", "ended"}
        if isinstance(said, dict) and (said.keys() & ends or said.keys() >= {"stage", "fraction"}):
            return said
    except ValueError:
        pass
    _log.error("a task's process sent an invalid message: %r", line[:200])
    raise Problem("internal", "the work sent a message that cannot be read")


def _tell(process: _Process, answer: Answer | None, question: str) -> None:
    """Answer a task's question; a task that is gone by then is found dead later."""
    if answer is None:
        raise Problem("internal", "the work asked a question, but this task has no answers")
    line = json.dumps({"answer": answer(question)}).encode() + b"\n"
    with suppress(BrokenPipeError):
        process.tell(line)


def _problem(plain: Mapping[str, Any]) -> Problem:
    kind = str(plain.get("kind"))
    extra = {name: value for name, value in plain.items() if name not in ("kind", "detail")}
    return Problem(kind if kind in KINDS else "internal", str(plain.get("detail", "")), **extra)
