"""What only the table knows of a job at work: whose it is, whether it is to stop, how many workers it has cost."""

from __future__ import annotations

from service.jobs.durable_jobs import DurableJobs
from service.jobs.port import Job, State


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
