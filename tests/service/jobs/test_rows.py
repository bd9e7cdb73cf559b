"""What only the table knows of a job at work: whose it is, whether it is to stop, how many workers it has cost."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

from service.clock import ago
from service.jobs.durable_jobs import DurableJobs
from service.jobs.port import Job, State, Step
from service.jobs.runner import Runner
from service.problems import Problem


def begun(jobs: DurableJobs, worker: str = "one") -> Job:
    jobs.submit(Job("a", "t", "key", "three", State.QUEUED, {}))
    job = jobs.begin("a", worker)
    assert job is not None
    return job


def test_who_lost_a_job_can_change_it_no_more(jobs: DurableJobs) -> None:
    first, second = begun(jobs), begun(jobs, "two")
    assert jobs.progress("a", "mark", 0.5, second.attempts)
    before = jobs.get("t", "a")
    assert not jobs.progress("a", "read", 0.1, first.attempts)
    assert not jobs.progress("a", "mark", 0.5, first.attempts), "nor where it would change nothing"
    assert jobs.get("t", "a") == before
    jobs.settled(first)
    assert begun(jobs).tries == 3, "a step that it did does not count as the other's"


def test_cancelling_is_seen_while_progress_stands_still(jobs: DurableJobs) -> None:
    job = begun(jobs)
    assert jobs.progress("a", "mark", 0.5, job.attempts)
    assert jobs.progress("a", "mark", 0.5, job.attempts)
    jobs.cancel("t", "a")
    assert not jobs.progress("a", "mark", 0.5, job.attempts)


def test_workers_lost_at_one_step_are_counted(jobs: DurableJobs) -> None:
    assert [begun(jobs).tries for _ in range(3)] == [1, 2, 3]
    jobs.settled(begun(jobs))
    assert begun(jobs).tries == 2, "the step before is done"


def test_a_worker_that_is_shut_down_does_not_count(jobs: DurableJobs) -> None:
    for _ in range(20):
        assert begun(jobs).tries == 1
        jobs.handed_back("one")


def test_a_job_that_its_engine_ended_without_a_result_has_failed(jobs: DurableJobs) -> None:
    for job_id, hours in (("old", 1.0), ("young", 0.0)):
        jobs.submit(Job(job_id, job_id, "key", "three", State.QUEUED, {}, created_at=ago(hours)))
        jobs.client().cancel_workflow(job_id)  # by its engine's own tools
    jobs.reconcile()
    old, young = jobs.get("old", "old"), jobs.get("young", "young")
    assert old is not None
    assert young is not None
    assert (old.state, young.state) == (State.FAILED, State.QUEUED)
    assert old.problem is not None
    assert old.problem["detail"] == "the work ended without a result"


def test_work_goes_on_while_its_progress_cannot_be_written(tmp_path: Path) -> None:
    class Away:
        def progress(self, *output: object) -> bool:
            raise Problem("unavailable", "the database does not answer")

    class Asking:
        def run(self, task: str, request: object, folder: Path, go_on: Any, answer: object) -> dict[str, Any]:
            return {"goes_on": go_on("mark", 0.5)}

    away: Any = Away()
    asking: Any = Asking()
    runner = Runner(away, {}, asking, tmp_path, "one", threading.Event())
    step = Step("mark", lambda run: run.work("embed", {}))
    assert runner._do(Job("a", "t", "key", "embed", State.RUNNING, {}), step, {}) == {"goes_on": True}
