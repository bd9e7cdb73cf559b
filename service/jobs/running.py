"""One job from its first step to its end, in a worker."""

import logging
import secrets
import shutil
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from service.jobs.child import Children, Stopped
from service.jobs.durable import DurableJobs
from service.jobs.port import Cancelled, Flow, Run, State, Step
from service.jobs.rows import Attempt
from service.problems import Problem

MAX_TRIES = 8
"""So many workers may be lost at one step of a job: then it is the job that ends them."""

_UNAVAILABLE = frozenset({"unavailable"})
_OUT_OF_REACH = _UNAVAILABLE | {"storage-full"}
"""A full disk fails the step that fills it; what the job's row must say waits for space."""

MAX_KILLED = 3
"""Runs of a task whose process is killed from outside. A task that is too large is killed each time."""

_FIRST_WAIT_SECONDS, _LONGEST_WAIT_SECONDS = 0.5, 5.0

_log = logging.getLogger(__name__)
T = TypeVar("T")


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
            attempt = self._patiently(lambda: self._jobs.begin(job_id, self._worker), _OUT_OF_REACH)
            if attempt is None:
                return
            try:
                state, value = self._steps(attempt)
            except Exception:
                _log.exception("job %s failed", job_id)
                state, value = State.FAILED, _internal()
            self._patiently(lambda: self._jobs.result(job_id, state, value, attempt.number), _OUT_OF_REACH)
            _log.info("job %s %s", job_id, state)
        finally:
            self.active.discard(job_id)

    def _steps(self, attempt: Attempt) -> tuple[State, Mapping[str, Any]]:
        from dbos import DBOS

        job = attempt.job
        if attempt.tries > MAX_TRIES:
            _log.error("job %s is given up: it was begun %s times in vain", job.id, MAX_TRIES)
            return State.FAILED, Problem("engine-limit", f"the work was ended {MAX_TRIES} times").to_json()
        results: dict[str, Any] = {}
        for step in self._flows[job.kind]:
            outcome = DBOS.run_step({"name": step.name}, self._step, attempt, step, results)
            if "problem" in outcome:
                return State.FAILED, outcome["problem"]
            if "cancelled" in outcome:
                return State.CANCELLED, {}
            results[step.name] = outcome["kept"]
        last = results[step.name]
        return State(last["state"]), last["result"]

    def _step(self, attempt: Attempt, step: Step, results: Mapping[str, Any]) -> dict[str, Any]:
        """What is kept of a step. How it failed is kept as a value too: it would fail again."""
        try:
            kept = self._patiently(lambda: self._do(attempt, step, results))
            self._patiently(lambda: self._jobs.settled(attempt.job.id, attempt.number))
        except Cancelled:
            return {"cancelled": True}
        except Problem as problem:
            return {"problem": problem.to_json()}
        except Exception:
            _log.exception("job %s failed in step %s", attempt.job.id, step.name)
            return {"problem": _internal()}
        return {"kept": kept}

    def _do(self, attempt: Attempt, step: Step, results: Mapping[str, Any]) -> dict[str, Any]:
        folder = self._scratch / f"{attempt.job.id}-{secrets.token_hex(4)}"

        def go_on(stage: str, fraction: float) -> bool:
            try:
                return self._jobs.progress(attempt.job.id, stage or step.name, fraction, attempt.number)
            except Problem as problem:
                if problem.kind not in _OUT_OF_REACH:
                    raise
                return True  # nobody can see how far it is, or ask it to stop, and the work goes on

        def work(task: str, request: Mapping[str, Any]) -> dict[str, Any]:
            for _ in range(MAX_KILLED - 1):
                try:
                    return self._children.run(task, request, folder, go_on)
                except Problem as problem:
                    if problem.extra.get("signal") != "SIGKILL":
                        raise
                    _log.warning("job %s: the process of task %s was killed; once more", attempt.job.id, task)
            return self._children.run(task, request, folder, go_on)

        folder.mkdir(parents=True)
        try:
            if not go_on(step.name, 0.0):
                raise Cancelled
            return step.do(Run(attempt.job, dict(results), folder, work))
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def _patiently(self, call: Callable[[], T], wait_out: frozenset[str] = _UNAVAILABLE) -> T:
        """The result of a call, made again and again while the database or the store does not answer."""
        wait = _FIRST_WAIT_SECONDS
        while not self._stopping.is_set():
            try:
                return call()
            except Stopped:
                break
            except Problem as problem:
                if problem.kind not in wait_out:
                    raise
                _log.warning("waiting: %s", problem.detail)
            self._stopping.wait(wait)
            wait = min(2 * wait, _LONGEST_WAIT_SECONDS)
        _stand_still()


def _stand_still() -> NoReturn:
    """The process is about to end. Returning or raising would tell DBOS that the job has ended, which is not so."""
    while True:
        time.sleep(3600)


def _internal() -> dict[str, Any]:
    return Problem("internal", "the work failed by a fault of this service").to_json()
