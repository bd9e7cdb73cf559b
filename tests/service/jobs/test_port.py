"""What every engine behind the port promises: SQLite, PostgreSQL and a plain fake."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from service.jobs.port import FINAL, Job, State
from service.problems import Problem
from tests.service.jobs.conftest import Clock, new_settings, opened
from tests.service.jobs.fake import FakeJobs

ENDS: list[tuple[State, dict[str, Any]]] = [
    (State.SUCCEEDED, {"asset": "a"}),
    (State.DISPUTED, {"asset": "a", "disputed": True}),
    (State.FAILED, Problem("capacity", "too many", wanted=64).to_json()),
    (State.CANCELLED, {}),
]


class Engine:
    """The port, and the worker's side of each implementation."""

    def __init__(self, jobs: Any) -> None:
        self.jobs = jobs
        worker = jobs if isinstance(jobs, FakeJobs) else None
        self.begin = worker.begin if worker else jobs.begin
        self.beat = worker.beat if worker else jobs.presence.beat
        self.leave = worker.leave if worker else jobs.presence.leave


@pytest.fixture(params=["fake", "sqlite", "postgres"])
def engine(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Engine]:
    if request.param == "fake":
        yield Engine(FakeJobs())
    else:
        with opened(new_settings(request.param, request, tmp_path / "data")) as jobs:
            yield Engine(jobs)


def new(job_id: str, tenant: str = "t", **values: Any) -> Job:
    return Job(job_id, tenant, "key", "embed", State.QUEUED, {"model": "m", "bits": 32}, **values)


def test_a_job_is_what_was_asked_for(engine: Engine) -> None:
    taken = engine.jobs.submit(new("a"))
    assert taken == engine.jobs.get("t", "a")
    assert (taken.state, taken.kind, taken.api_key, taken.revision) == (State.QUEUED, "embed", "key", 0)
    assert taken.request == {"model": "m", "bits": 32}
    assert taken.created_at
    assert (taken.started_at, taken.finished_at, taken.result, taken.problem) == ("", "", None, None)


def test_the_same_id_twice_is_one_job(engine: Engine) -> None:
    engine.jobs.submit(new("a"))
    engine.begin("a", "w")
    again = engine.jobs.submit(new("a"))
    assert again.state == State.RUNNING
    assert len(engine.jobs.list("t")) == 1


def test_another_tenant_sees_nothing(engine: Engine) -> None:
    engine.jobs.submit(new("a"))
    assert engine.jobs.get("other", "a") is None
    assert list(engine.jobs.list("other")) == []
    assert engine.jobs.cancel("other", "a") is None
    assert engine.jobs.get("t", "a").state == State.QUEUED  # type: ignore[union-attr]


def test_lists_go_from_new_to_old_in_pages(engine: Engine) -> None:
    times = ["2026-01-01", "2026-01-02", "2026-01-02", "2026-01-03"]
    for job_id, created in zip("abcd", times, strict=True):
        engine.jobs.submit(new(job_id, created_at=created))
    engine.jobs.submit(new("z", tenant="other"))
    seen: list[str] = []
    while page := engine.jobs.list("t", limit=2, after=seen[-1] if seen else ""):
        seen += [job.id for job in page]
    assert seen == ["d", "c", "b", "a"]
    for after in ("z", "unknown"):  # the place of another tenant's job is not told
        with pytest.raises(Problem) as refused:
            engine.jobs.list("t", after=after)
        assert refused.value.kind == "invalid-request"


def test_lists_are_narrowed(engine: Engine) -> None:
    for number, kind in enumerate(("embed", "verify", "verify", "dispute")):
        job = Job(f"j{number}", "t", "key", kind, State.QUEUED, {}, created_at=f"2026-01-0{number + 1}")
        engine.jobs.submit(job)
    engine.begin("j1", "w")
    engine.jobs.cancel("t", "j3")
    for states, kind, expected in (
        ((), "", ["j3", "j2", "j1", "j0"]),
        (("queued",), "", ["j2", "j0"]),
        (("queued", "running"), "verify", ["j2", "j1"]),
        ((), "dispute", ["j3"]),
        (("failed",), "", []),
    ):
        assert [job.id for job in engine.jobs.list("t", states=states, kind=kind)] == expected
    assert [job.id for job in engine.jobs.list("t", 1, "j2", ["queued"])] == ["j0"]


def test_progress_is_seen_and_counted(engine: Engine) -> None:
    engine.jobs.submit(new("a"))
    assert not engine.jobs.progress("a", "embed", 0.1), "no worker has a queued job"
    engine.begin("a", "w")
    before = engine.jobs.get("t", "a")
    assert before is not None
    assert before.started_at
    assert engine.jobs.progress("a", "embed", 0.25)
    after = engine.jobs.get("t", "a")
    assert after is not None
    assert (after.stage, after.fraction, after.revision) == ("embed", 0.25, before.revision + 1)
    assert engine.jobs.progress("a", "embed", 0.25)
    assert engine.jobs.get("t", "a") == after, "nothing changed, nothing is written"
    assert not engine.jobs.progress("nothing", "embed", 0.1)


def test_a_queued_job_is_cancelled_at_once(engine: Engine) -> None:
    engine.jobs.submit(new("a"))
    job = engine.jobs.cancel("t", "a")
    assert job is not None
    assert (job.state, job.cancelling, job.revision) == (State.CANCELLED, True, 1)
    assert job.finished_at
    engine.begin("a", "w")
    assert engine.jobs.get("t", "a") == job, "it is not begun any more"


def test_a_running_job_is_asked_to_stop(engine: Engine) -> None:
    engine.jobs.submit(new("a"))
    engine.begin("a", "w")
    job = engine.jobs.cancel("t", "a")
    assert job is not None
    assert (job.state, job.cancelling) == (State.RUNNING, True)
    assert not engine.jobs.progress("a", "embed", 0.5)
    assert engine.jobs.cancel("t", "a") == job, "asking twice changes nothing"
    engine.jobs.result("a", State.CANCELLED, {})
    assert engine.jobs.get("t", "a").state == State.CANCELLED  # type: ignore[union-attr]


@pytest.mark.parametrize(("state", "value"), ENDS)
def test_the_first_end_is_the_end(engine: Engine, state: State, value: dict[str, Any]) -> None:
    engine.jobs.submit(new("a"))
    engine.begin("a", "w")
    engine.jobs.result("a", state, value)
    ended = engine.jobs.get("t", "a")
    assert ended is not None
    assert ended.state == state
    assert ended.state in FINAL
    assert ended.finished_at
    assert ended.result == (value if state in (State.SUCCEEDED, State.DISPUTED) else None)
    assert ended.problem == (value if state == State.FAILED else None)
    for other, another in ENDS:
        engine.jobs.result("a", other, another)
    engine.jobs.cancel("t", "a")
    assert not engine.jobs.progress("a", "late", 0.9)
    assert engine.jobs.get("t", "a") == ended


def test_only_final_states_end_a_job(engine: Engine) -> None:
    engine.jobs.submit(new("a"))
    with pytest.raises(ValueError, match="running"):
        engine.jobs.result("a", State.RUNNING, {})


def test_silent_workers_are_given_up_and_living_ones_are_not(engine: Engine, clock: Clock) -> None:
    engine.beat("living")
    engine.beat("dead")
    assert list(engine.jobs.recover(30)) == []
    for _ in range(4):
        clock.now += 10
        engine.beat("living")
    assert list(engine.jobs.recover(30)) == ["dead"]
    assert list(engine.jobs.recover(30)) == [], "once is enough"


def test_a_worker_that_left_is_not_waited_for(engine: Engine) -> None:
    engine.beat("polite")
    engine.leave("polite")
    assert list(engine.jobs.recover(60)) == ["polite"]
