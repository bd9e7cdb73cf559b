"""Workers that run jobs, are killed, and take over from each other; on both databases."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import time
from contextlib import closing
from pathlib import Path

import pytest

from service.db import Database
from service.jobs.durable_jobs import DurableJobs
from service.jobs.port import Job, State
from service.jobs.runner import MAX_TRIES
from service.problems import Problem
from service.settings import DATABASE, JOBS_DATABASE, Settings
from tests.service import serving
from tests.service.jobs.conftest import Workshop, new_settings, opened
from tests.service.jobs.test_child import gone_within, pid_in
from tests.service.postgres import Postgres

# What does not depend on the database is tried on one of them: a worker takes a second to start.
ON_SQLITE = pytest.mark.parametrize("settings", ["sqlite"], indirect=True)
ON_POSTGRES = pytest.mark.parametrize("settings", ["postgres"], indirect=True)

ALL_MARKS = ["first", "second begins", "second ends", "commit"]


def kinds(lines: list[str]) -> list[str]:
    """What was written down, without who did it."""
    return [line.split(" after")[0] for line in lines]


def in_second_step(shop: Workshop, job_id: str, times: int = 1) -> None:
    shop.wait(lambda: kinds(shop.wrote(job_id)).count("second begins") == times)


def stop_between_writes(worker: subprocess.Popen[bytes], shop: Workshop) -> None:
    """Who is stopped while it writes keeps the lock of that SQLite database until it wakes or dies, which is not
    what is asked."""
    while True:
        worker.send_signal(signal.SIGSTOP)
        # A signal is sent before it is obeyed: one more write went between.
        os.waitid(os.P_PID, worker.pid, os.WSTOPPED)
        try:
            for database in (DATABASE, JOBS_DATABASE):
                path = shop.settings.data_dir / database
                with closing(sqlite3.connect(path, timeout=0.5, isolation_level=None)) as connection:
                    connection.execute("BEGIN IMMEDIATE")
            return
        except sqlite3.OperationalError:
            worker.send_signal(signal.SIGCONT)


def test_jobs_of_every_kind_end_as_they_must(workshop: Workshop) -> None:
    workshop.gate.touch()
    workshop.submit("steps", "three")
    workshop.submit("disputed", "three", end="disputed")
    workshop.task("reply", "echo", n=1)
    workshop.submit("refuse", "refuse")
    workshop.submit("bug", "bug")
    workshop.submit("unkept", "unkept")
    workshop.submit("store", "outage")
    workshop.task("fails", "fail", error="CapacityError", arguments={"args": ["no"], "wanted": 9, "capacity": 3})
    worker = workshop.start("local-1")

    steps = workshop.ended("steps")
    assert (steps.state, steps.result, steps.fraction) == (State.SUCCEEDED, {"total": 3}, 1.0)
    assert kinds(workshop.wrote("steps")) == ALL_MARKS
    assert workshop.ended("disputed").state == State.DISPUTED
    reply = workshop.ended("reply").result
    assert reply is not None
    assert reply["task"]["request"] == {"n": 1}

    refused = workshop.ended("refuse").problem
    assert refused is not None
    assert (refused["type"], refused["wanted"]) == ("urn:mark3dgs:problem:capacity", 64)
    assert workshop.wrote("refuse") == ["refused"], "a refusal is not tried again"
    fails = workshop.ended("fails").problem
    assert fails is not None
    assert (fails["type"], fails["capacity"]) == ("urn:mark3dgs:problem:capacity", 3)
    for job_id in ("bug", "unkept"):
        problem = workshop.ended(job_id).problem
        assert problem is not None
        assert problem["type"] == "urn:mark3dgs:problem:internal"
        assert "secret" not in problem["detail"]
    assert "job bug failed in step bug" in workshop.log.read_text()
    assert workshop.ended("store").state == State.SUCCEEDED, "a store that does not answer is waited for"
    assert len(workshop.wrote("store")) == 3

    # Submitted to an idle worker, a job starts at once.
    started = time.monotonic()
    workshop.task("quick", "echo")
    workshop.ended("quick")
    assert time.monotonic() - started < 5.0
    scratch = workshop.settings.scratch / "work" / "local-1"
    assert list(scratch.iterdir()) == [], "every step's folder is removed"

    said = workshop.log.read_text()
    assert not [word for word in ("Initializing", "Conductor", "http", "Queue") if word in said], "DBOS is quiet"
    started = time.monotonic()
    worker.stdin.close()  # type: ignore[union-attr]
    assert worker.wait(5) == 0
    assert time.monotonic() - started < 5


def test_a_killed_workers_job_goes_on_at_its_last_finished_step(workshop: Workshop) -> None:
    workshop.submit("a", "three")
    first = workshop.start("one")
    in_second_step(workshop, "a")
    second = workshop.start("two")
    workshop.wait(lambda: "worker two is ready" in workshop.log.read_text())
    first.send_signal(signal.SIGKILL)
    in_second_step(workshop, "a", times=2)
    workshop.gate.touch()
    assert workshop.ended("a").result == {"total": 3}
    assert kinds(workshop.wrote("a")) == ["first", "second begins", "second begins", "second ends", "commit"]
    assert str(second.pid) in workshop.wrote("a")[2]
    assert not (workshop.settings.scratch / "work" / "one").exists(), "who takes over tidies up"


@ON_SQLITE
def test_a_worker_that_comes_back_under_its_name_goes_on_at_once(workshop: Workshop) -> None:
    workshop.submit("a", "three")
    workshop.start("local-1", worker_silence_seconds=600)
    in_second_step(workshop, "a")
    workshop.processes[0].kill()
    workshop.processes[0].wait()
    left = workshop.settings.scratch / "work" / "local-1" / "left-over"
    left.mkdir()
    workshop.start("local-1", worker_silence_seconds=600)
    in_second_step(workshop, "a", times=2)
    workshop.gate.touch()
    assert workshop.ended("a").state == State.SUCCEEDED
    assert kinds(workshop.wrote("a")).count("first") == 1
    assert not left.exists()


@ON_SQLITE
def test_a_task_killed_from_outside_runs_once_more(workshop: Workshop, tmp_path: Path) -> None:
    workshop.task("a", "die_once", marker=str(tmp_path / "marker"))
    workshop.task("b", "die", signal="SIGKILL")
    workshop.start("one")
    assert workshop.ended("a").state == State.SUCCEEDED
    ended = workshop.ended("b")
    assert ended.state == State.FAILED, "a task that is killed each time is given up"
    assert ended.problem is not None
    assert ended.problem["type"] == "urn:mark3dgs:problem:engine-limit"


@ON_SQLITE
def test_a_worker_told_to_stop_hands_its_job_back(workshop: Workshop, tmp_path: Path) -> None:
    workshop.task("a", "nap", pid_file=str(tmp_path / "pid"), seconds=1)
    first = workshop.start("one")
    pid = pid_in(tmp_path / "pid")
    (tmp_path / "pid").unlink()
    started = time.monotonic()
    first.terminate()
    assert first.wait(5) == 0
    assert time.monotonic() - started < 5
    assert gone_within(pid, 1.0)
    left = workshop.job("a")
    assert (left.state, left.tries) == (State.RUNNING, 0), "a shut-down counts as no failed attempt"
    workshop.start("two", worker_silence_seconds=600)  # it need not wait out the silence
    assert workshop.ended("a").state == State.SUCCEEDED
    assert pid_in(tmp_path / "pid") != pid


@ON_SQLITE
def test_cancelling_kills_the_task(workshop: Workshop, tmp_path: Path) -> None:
    workshop.task("a", "nap", pid_file=str(tmp_path / "pid"))
    workshop.start("one")
    pid = pid_in(tmp_path / "pid")
    job = workshop.jobs.cancel("tenant", "a")
    assert job is not None
    assert job.cancelling
    assert gone_within(pid, 1.5)
    assert workshop.ended("a").state == State.CANCELLED
    workshop.task("b", "echo")
    assert workshop.ended("b").state == State.SUCCEEDED


@ON_SQLITE
def test_a_job_that_ends_its_workers_is_given_up(workshop: Workshop) -> None:
    workshop.submit("bad", "poison")
    workshop.task("good", "echo")
    worker = workshop.start("local-1")

    def brought_back() -> bool:
        nonlocal worker
        if worker.poll() is not None:
            worker = workshop.start("local-1")
        return workshop.job("bad").state == State.FAILED

    workshop.wait(brought_back, 60)
    problem = workshop.job("bad").problem
    assert problem is not None
    assert problem["type"] == "urn:mark3dgs:problem:engine-limit"
    assert workshop.wrote("bad") == ["first"] + ["poison"] * MAX_TRIES
    assert workshop.ended("good").state == State.SUCCEEDED


@ON_POSTGRES
def test_a_job_that_was_never_enqueued_is_found(workshop: Workshop) -> None:
    """As if the API had died between the row and the queue."""
    workshop.gate.touch()
    job = Job("a", "tenant", "key", "three", State.QUEUED, {"marks": str(workshop.marks), "gate": str(workshop.gate)})
    workshop.jobs.submit(job)
    workshop.start("one")
    assert workshop.ended("a").state == State.SUCCEEDED


@ON_POSTGRES
def test_several_workers_run_every_job_once(workshop: Workshop) -> None:
    workshop.gate.touch()
    ids = [f"j{number}" for number in range(12)]
    for job_id in ids:
        workshop.submit(job_id, "three")
    for name in ("one", "two"):
        workshop.start(name)
    for job_id in ids:
        workshop.ended(job_id)
        assert kinds(workshop.wrote(job_id)) == ALL_MARKS


@ON_SQLITE
def test_a_stopped_process_that_wakes_up_changes_nothing(workshop: Workshop) -> None:
    """Taken for dead, its job done by another: what it still says is not heard."""
    workshop.submit("a", "three")
    sleeper = workshop.start("one")
    in_second_step(workshop, "a")
    stop_between_writes(sleeper, workshop)
    workshop.start("two")
    in_second_step(workshop, "a", times=2)
    workshop.gate.touch()
    ended = workshop.ended("a")
    assert ended.state == State.SUCCEEDED
    sleeper.send_signal(signal.SIGCONT)
    workshop.wait(lambda: kinds(workshop.wrote("a")).count("second ends") == 2)
    time.sleep(1.0)
    assert workshop.job("a") == ended
    assert kinds(workshop.wrote("a")).count("commit") == 1
    workshop.task("b", "echo")
    workshop.task("c", "echo")
    for job_id in ("b", "c"):
        assert workshop.ended(job_id).state == State.SUCCEEDED
    assert sleeper.poll() is None, "it is a worker like any other again"


@ON_SQLITE
def test_the_engines_file_is_in_wal_mode(workshop: Workshop) -> None:
    workshop.task("a", "echo")
    with sqlite3.connect(workshop.settings.data_dir / "jobs.sqlite") as connection:
        assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)


def test_a_database_outage_is_waited_out(request: pytest.FixtureRequest, tmp_path: Path) -> None:
    request.getfixturevalue("postgres")  # skips where there is none; this test has a server of its own to stop
    server = Postgres()
    request.addfinalizer(server.close)
    settings = new_settings("sqlite", request, tmp_path / "data")
    settings.database_url = server.new_database("outage")
    with opened(settings) as jobs:
        shop = Workshop(settings, jobs, tmp_path)
        request.addfinalizer(shop.close)
        shop.submit("a", "three")
        worker = shop.start("one")
        in_second_step(shop, "a")
        server.stop()
        with pytest.raises(Problem, match="does not answer"):
            shop.submit("b", "three")
        shop.gate.touch()
        shop.wait(lambda: "waiting: the database does not answer" in shop.log.read_text())
        server.start()
        assert shop.ended("a", 30).state == State.SUCCEEDED
        assert kinds(shop.wrote("a")) == ALL_MARKS, "no step was done again"
        assert worker.poll() is None
        shop.submit("b", "three")
        assert shop.ended("b").state == State.SUCCEEDED


def test_a_worker_that_never_reaches_its_database_ends(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, database_url=f"postgresql://nobody@127.0.0.1:{serving.free_port()}/nothing")
    db = Database(settings.database())
    shop = Workshop(settings, DurableJobs(db, settings.jobs_database()), tmp_path)
    worker = shop.start("one", database_wait_seconds=1)
    assert worker.wait(120) == 1
    said = shop.log.read_text()
    assert said.count("worker one cannot start yet") >= 2
    assert "it could not start within 1 s: the database does not answer" in said
    db.close()


def taken_from_the_queue(shop: Workshop, job_id: str, worker: str) -> None:
    """As DBOS leaves a job that it took in the moment the database went away."""
    with sqlite3.connect(shop.settings.data_dir / "jobs.sqlite") as connection:
        connection.execute(
            "UPDATE workflow_status SET status = 'PENDING', executor_id = ? WHERE workflow_uuid = ?", (worker, job_id)
        )
    connection.close()


@ON_SQLITE
def test_a_job_that_was_taken_and_not_begun_goes_back_to_the_queue(workshop: Workshop) -> None:
    workshop.start("one", worker_silence_seconds=600)
    workshop.wait(lambda: "worker one is ready" in workshop.log.read_text())
    workshop.processes[0].send_signal(signal.SIGSTOP)
    workshop.task("a", "echo")
    taken_from_the_queue(workshop, "a", "one")
    workshop.processes[0].send_signal(signal.SIGCONT)
    assert workshop.ended("a").state == State.SUCCEEDED


@ON_SQLITE
def test_who_lost_a_job_stops_within_its_step(workshop: Workshop, tmp_path: Path) -> None:
    """DBOS would stop it at the step's end, which may be an hour away."""
    pid_file = tmp_path / "pid"
    workshop.task("a", "nap", pid_file=str(pid_file), seconds=600)
    workshop.start("one")
    pid = pid_in(pid_file)
    workshop.start("two")
    workshop.wait(lambda: "worker two is ready" in workshop.log.read_text())
    workshop.jobs.requeue(["a"])
    workshop.wait(lambda: pid_in(pid_file) != pid)
    assert gone_within(pid, 10.0)
    time.sleep(1.0)
    assert workshop.job("a").state == State.RUNNING, "it is the other's now"
    workshop.jobs.cancel("tenant", "a")
    assert workshop.ended("a").state == State.CANCELLED
