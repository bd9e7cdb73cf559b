"""A worker: a process that runs jobs one at a time, reports that it is alive, and takes over from dead ones."""

import logging
import os
import re
import secrets
import shutil
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn, TypedDict, TypeVar

from service.folder_locks import hold
from service.jobs.durable_jobs import QUEUE, WORKFLOW, DurableJobs, configuration
from service.jobs.port import Flow, Job, Run, State, Step
from service.problems import Problem
from service.processes import COMMAND, Answer, Cancelled, Children, Limits, Reply, Stopped
from service.settings import Settings

BEAT_SECONDS = 2.0
"""Between two signs of life; `worker_silence_seconds` is several of them."""

POLL_SECONDS = 0.4
"""Between two looks into the queue."""

MAX_TRIES = 8
"""So many workers may be lost at one step of a job: then it is the job that ends them.

DBOS counts how often a workflow was recovered: over all its steps, and anew after a takeover.
"""

MAX_KILLED = 3
"""Runs of a task whose process is killed from outside. A task that is too large is killed each time."""

PREDECESSOR_SECONDS = 15.0
"""A worker whose parent died is still ending when the next one of its name starts."""

_UNAVAILABLE = frozenset({"unavailable"})
_OUT_OF_REACH = _UNAVAILABLE | {"storage-full"}
"""A full disk fails the step that fills it; what the job's row must say waits for space."""

_FIRST_WAIT_SECONDS, _LONGEST_WAIT_SECONDS = 0.5, 5.0
_LAST_WORDS_SECONDS = 2.0

_log = logging.getLogger(__name__)
T = TypeVar("T")


class Outcome(TypedDict, total=False):
    """The kept outcome of a step: one of the three."""

    kept: Mapping[str, Any]  # its result
    problem: Mapping[str, Any]  # as in RFC 9457
    cancelled: bool


class Runner:
    """Runs jobs, each step once, in folders under `scratch`; `active` are those running here."""

    def __init__(
        self,
        jobs: DurableJobs,
        flows: Mapping[str, Flow],
        children: Children,
        scratch: Path,
        worker: str,
        stopping: threading.Event,
    ) -> None:
        self._jobs, self._flows, self._children = jobs, flows, children
        self._scratch, self._worker, self._stopping = scratch, worker, stopping
        self.active: set[str] = set()

    def run(self, job_id: str) -> None:
        """The workflow: returns once the job's row is final. What it raises, DBOS would take for an end."""
        self.active.add(job_id)
        try:
            job = self._patiently(lambda: self._jobs.begin(job_id, self._worker), _OUT_OF_REACH)
            if job is None:
                return
            try:
                state, value = self._steps(job)
            except Exception:
                _log.exception("job %s failed", job_id)
                state, value = State.FAILED, _internal()
            self._patiently(lambda: self._jobs.result(job_id, state, value), _OUT_OF_REACH)
            _log.info("job %s %s", job_id, state)
        finally:
            self.active.discard(job_id)

    def _steps(self, job: Job) -> tuple[State, Mapping[str, Any]]:
        from dbos import DBOS

        if job.tries > MAX_TRIES:
            _log.error("job %s failed: it was begun %s times without a result", job.id, MAX_TRIES)
            return State.FAILED, Problem("engine-limit", f"the work was ended {MAX_TRIES} times").to_json()
        results: dict[str, Mapping[str, Any]] = {}
        for step in self._flows[job.kind]:
            outcome = DBOS.run_step({"name": step.name}, self._step, job, step, results)
            if "problem" in outcome:
                return State.FAILED, outcome["problem"]
            if "cancelled" in outcome:
                return State.CANCELLED, {}
            results[step.name] = outcome["kept"]
        last = results[step.name]
        return State(last["state"]), last["result"]

    def _step(self, job: Job, step: Step, results: Mapping[str, Mapping[str, Any]]) -> Outcome:
        """The kept outcome of a step. A failure is kept as a value, too: it would happen again."""
        try:
            kept = self._patiently(lambda: self._do(job, step, results))
            self._patiently(lambda: self._jobs.settled(job))
        except Cancelled:
            return {"cancelled": True}
        except Problem as problem:
            return {"problem": problem.to_json()}
        except Exception:
            _log.exception("job %s failed in step %s", job.id, step.name)
            return {"problem": _internal()}
        return {"kept": kept}

    def _do(self, job: Job, step: Step, results: Mapping[str, Mapping[str, Any]]) -> Mapping[str, Any]:
        folder = self._scratch / f"{job.id}-{secrets.token_hex(4)}"

        def go_on(stage: str, fraction: float) -> bool:
            try:
                return self._jobs.progress(job.id, stage or step.name, fraction, job.attempts)
            except Problem as problem:
                if problem.kind not in _OUT_OF_REACH:
                    raise
                return True  # its progress is not shown and it cannot be stopped, but the work continues

        def work(task: str, request: Mapping[str, Any], answer: Answer | None = None) -> Reply:
            for _ in range(MAX_KILLED - 1):
                try:
                    return self._children.run(task, request, folder, go_on, answer)
                except Problem as problem:
                    if problem.extra.get("signal") != "SIGKILL":
                        raise
                    _log.warning("job %s: the process of task %s was killed; once more", job.id, task)
            return self._children.run(task, request, folder, go_on, answer)

        folder.mkdir(parents=True)
        try:
            if not go_on(step.name, 0.0):
                raise Cancelled
            return step.do(Run(job, dict(results), folder, work))
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def _patiently(self, call: Callable[[], T], wait_out: frozenset[str] = _UNAVAILABLE) -> T:
        """The result of a call, made again and again while the database or the store does not answer."""
        for _ in _tries(self._stopping):
            try:
                return call()
            except Stopped:
                break
            except Problem as problem:
                if problem.kind not in wait_out:
                    raise
                _log.warning("waiting: %s", problem.detail)
        _stand_still()


def _tries(stopping: threading.Event) -> Iterator[None]:
    """Turns of a loop, each after a pause twice as long as the one before, until it is to stop."""
    wait = _FIRST_WAIT_SECONDS
    while not stopping.is_set():
        yield
        stopping.wait(wait)
        wait = min(2 * wait, _LONGEST_WAIT_SECONDS)


def _stand_still() -> NoReturn:
    """The process is about to end. Returning or raising would tell DBOS that the job has ended, which is not so."""
    while True:
        time.sleep(3600)


def _internal() -> Mapping[str, Any]:
    return Problem("internal", "the work failed by a fault of this service").to_json()


class Worker:
    """One worker process; with `die_with_parent` it ends when standard input does. `command` starts a task's process.

    A worker that comes back under its `name` (letters, digits, dots and dashes) takes up its jobs at once; InputError
    where another process of this data folder has the name. Without one, a fresh name is made.
    """

    def __init__(
        self,
        settings: Settings,
        flows: Mapping[str, Flow],
        jobs: DurableJobs,
        *,
        name: str = "",
        die_with_parent: bool = False,
        command: Sequence[str] = COMMAND,
    ) -> None:
        self.name = name or _fresh_name()
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9.-]{0,99}", self.name):
            raise ValueError(f"no name of a worker: {self.name!r}")
        self._lock = hold(settings.data_dir, f"worker-{name}", PREDECESSOR_SECONDS) if name else None
        self._settings, self._jobs, self._die_with_parent = settings, jobs, die_with_parent
        self._stopping = threading.Event()
        self._idle: set[str] = set()
        self._children = Children(Limits.of(settings), command)
        scratch = _scratch(settings, self.name)
        self._runner = Runner(jobs, flows, self._children, scratch, self.name, self._stopping)

    def run(self) -> NoReturn:
        """Work until SIGTERM, SIGINT or the end of standard input; ends the process."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: self._stopping.set())
        if self._die_with_parent:
            threading.Thread(target=self._outlive_nobody, daemon=True).start()
        self._children.prepare()
        shutil.rmtree(_scratch(self._settings, self.name), ignore_errors=True)
        self._until_it_works(lambda: self._jobs.presence.beat(self.name))
        threading.Thread(target=self._beat, daemon=True).start()
        self._until_it_works(self._launch)
        while not self._stopping.wait(BEAT_SECONDS):
            self._watch()
        self._end()

    def _launch(self) -> None:
        """Start DBOS in this process: jobs begin to run, those of an earlier process of our name among them."""
        from dbos import DBOS

        self._jobs.client()  # makes the engine's tables
        DBOS(config=configuration(self._jobs.url, self.name))

        @DBOS.workflow(name=WORKFLOW, max_recovery_attempts=None)  # we count, by step
        def job(job_id: str) -> None:
            self._runner.run(job_id)

        try:
            DBOS.launch()
            DBOS.register_queue(
                QUEUE, worker_concurrency=1, polling_interval_sec=POLL_SECONDS, on_conflict="always_update"
            )
        except Exception:
            DBOS.destroy(destroy_registry=True)
            raise
        _log.info("worker %s is ready", self.name)

    def _until_it_works(self, call: Callable[[], Any]) -> None:
        """The database may go away while we start: for as long as it is waited for before."""
        patience = self._settings.database_wait_seconds
        until = time.monotonic() + patience
        for _ in _tries(self._stopping):
            try:
                call()
                return
            except Exception as error:
                if time.monotonic() > until:
                    _log.error("worker %s ends: it could not start within %g s: %s", self.name, patience, error)
                    self._end(1)
                _log.warning("worker %s cannot start yet: %s", self.name, error)
        self._end()

    def _beat(self) -> None:
        # A thread of its own, so that taking over a hundred jobs does not make us look dead.
        well = True
        while not self._stopping.wait(BEAT_SECONDS):
            try:
                self._jobs.presence.beat(self.name)
                well = True
            except Exception as error:
                if well:
                    _log.warning("worker %s cannot report that it is alive: %s", self.name, error)
                well = False

    def _watch(self) -> None:
        try:
            for silent in self._jobs.recover(self._settings.worker_silence_seconds, self.name):
                _log.warning("worker %s is silent; its jobs are taken over", silent)
                shutil.rmtree(_scratch(self._settings, silent), ignore_errors=True)
            self._jobs.reconcile()
            # DBOS forgets a job that it took from the queue in the moment the database went away.
            mine = {job_id for job_id, owner in self._jobs.taken().items() if owner == self.name}
            idle = mine - self._runner.active
            self._jobs.requeue(idle & self._idle)
            self._idle = idle
        except Exception as error:
            _log.warning("worker %s cannot watch over the others: %s", self.name, error)

    def _outlive_nobody(self) -> None:
        while os.read(0, 1 << 12):
            pass
        self._stopping.set()

    def _end(self, status: int = 0) -> NoReturn:
        """End as a killed worker would, but announced: a live worker takes up our job at its last finished step."""
        self._children.stop()
        last_words = threading.Thread(target=self._leave, daemon=True)
        last_words.start()
        last_words.join(_LAST_WORDS_SECONDS)
        shutil.rmtree(_scratch(self._settings, self.name), ignore_errors=True)
        _log.info("worker %s ends", self.name)
        logging.shutdown()
        os._exit(status)

    def _leave(self) -> None:
        try:
            self._jobs.handed_back(self.name)
            self._jobs.presence.leave(self.name)
        except Exception as error:
            _log.warning("worker %s ends without signing off: %s", self.name, error)


def _scratch(settings: Settings, worker: str) -> Path:
    return (settings.scratch / "work" / worker).absolute()


def _fresh_name() -> str:
    host = re.sub(r"[^A-Za-z0-9]", "-", socket.gethostname()).strip("-")[:60] or "host"
    return f"{host}-{os.getpid()}-{secrets.token_hex(3)}"
