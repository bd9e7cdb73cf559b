"""A worker whose flows leave marks in a file: `python -m tests.service.jobs.toy_worker NAME`."""

from __future__ import annotations

import logging
import os
import sys
import time
from pathlib import Path
from typing import Any

from service.db import Database
from service.jobs.durable_jobs import DurableJobs
from service.jobs.port import Run, Step
from service.jobs.runner import Worker
from service.problems import Problem
from service.settings import Settings

CHILD = (sys.executable, "-m", "tests.service.jobs.toy_tasks")


def mark(run: Run, what: str) -> None:
    """One line, in one write, so that a kill leaves all of it or nothing."""
    with open(run.job.request["marks"], "a") as file:
        file.write(f"{run.job.id} {what}\n")


def first(run: Run) -> dict[str, Any]:
    mark(run, "first")
    return {"made": 1}


def second(run: Run) -> dict[str, Any]:
    """Waits for the file `gate`, so that a test can kill the worker in the middle."""
    mark(run, f"second begins after {run.results['first']['made']} by {os.getpid()}")
    gate = Path(run.job.request["gate"])
    while not gate.exists():
        time.sleep(0.02)
    mark(run, "second ends")
    return {"made": 2}


def commit(run: Run) -> dict[str, Any]:
    mark(run, "commit")
    total = sum(result["made"] for result in run.results.values())
    return {"state": run.job.request.get("end", "succeeded"), "result": {"total": total}}


def task(run: Run) -> dict[str, Any]:
    return run.work(run.job.request["task"], run.job.request["arguments"])


def poison(run: Run) -> dict[str, Any]:
    mark(run, "poison")
    os.kill(os.getpid(), 9)
    return {}


def refuse(run: Run) -> dict[str, Any]:
    mark(run, "refused")
    raise Problem("capacity", "too many bits", wanted=64, capacity=12)


def break_down(run: Run) -> dict[str, Any]:
    raise ZeroDivisionError("a bug with /secret/path in it")


def outage(run: Run) -> dict[str, Any]:
    mark(run, "outage")
    if Path(run.job.request["marks"]).read_text().count("outage") < 3:
        raise Problem("unavailable", "the store does not answer")
    return {"made": 3}


def unkept(run: Run) -> dict[str, Any]:
    return {"value": object()}


def done(run: Run) -> dict[str, Any]:
    return {"state": "succeeded", "result": dict(run.results)}


FLOWS = {
    "three": (Step("first", first), Step("second", second), Step("commit", commit)),
    "task": (Step("task", task), Step("done", done)),
    "poison": (Step("first", first), Step("poison", poison)),
    "refuse": (Step("refuse", refuse), Step("done", done)),
    "bug": (Step("bug", break_down),),
    "outage": (Step("outage", outage), Step("done", done)),
    "unkept": (Step("unkept", unkept),),
}

if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    settings = Settings()
    db = Database(settings.database())
    jobs = DurableJobs(db, settings.jobs_database())
    Worker(settings, FLOWS, jobs, name=sys.argv[1], die_with_parent=True, command=CHILD).run()
