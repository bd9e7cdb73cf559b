"""The two databases, and workers in processes of their own."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from service.db import Database
from service.jobs import durable_jobs
from service.jobs.durable_jobs import DurableJobs
from service.jobs.port import FINAL, Job, State
from service.settings import Settings
from tests.service.jobs import fake

REPOSITORY = Path(__file__).parents[3]
_numbers = itertools.count()


def new_settings(database: str, request: pytest.FixtureRequest, folder: Path) -> Settings:
    """Settings of a new, empty service."""
    url = ""
    if database == "postgres":
        url = request.getfixturevalue("postgres").new_database(f"test{next(_numbers)}")
    folder.mkdir()
    return Settings(data_dir=folder, database_url=url, worker_silence_seconds=1.5)


@contextmanager
def opened(settings: Settings) -> Iterator[DurableJobs]:
    """The jobs of a service."""
    db = Database(settings.database())
    db.migrate()
    engine = DurableJobs(db, settings.jobs_database())
    yield engine
    engine.close()
    db.close()


@pytest.fixture(params=["sqlite", "postgres"])
def settings(request: pytest.FixtureRequest, tmp_path: Path) -> Settings:
    return new_settings(request.param, request, tmp_path / "data")


@pytest.fixture
def jobs(settings: Settings) -> Iterator[DurableJobs]:
    with opened(settings) as engine:
        yield engine


class Clock:
    """Stands in for the module `time`."""

    def __init__(self) -> None:
        self.now = 1000.0

    def monotonic(self) -> float:
        return self.now

    def time(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """The time by which silence is measured: it passes when a test moves it."""
    made = Clock()
    monkeypatch.setattr(durable_jobs, "time", made)
    monkeypatch.setattr(fake, "time", made)
    return made


class Workshop:
    """Toy workers over one database, their jobs and what they wrote down."""

    def __init__(self, settings: Settings, jobs: DurableJobs, folder: Path) -> None:
        self.settings, self.jobs, self.folder = settings, jobs, folder
        self.marks, self.gate, self.log = folder / "marks", folder / "gate", folder / "log"
        self.marks.touch()
        self.processes: list[subprocess.Popen[bytes]] = []

    def start(self, name: str, **environment: Any) -> subprocess.Popen[bytes]:
        own = {f"MARK3DGS_{key.upper()}": str(value) for key, value in environment.items()}
        own |= {
            "MARK3DGS_DATA_DIR": str(self.settings.data_dir),
            "MARK3DGS_DATABASE_URL": self.settings.database_url,
            "MARK3DGS_WORKER_SILENCE_SECONDS": str(self.settings.worker_silence_seconds),
        }
        with self.log.open("ab") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", "tests.service.jobs.toy_worker", name],
                cwd=REPOSITORY,
                env=os.environ | own,
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
            )
        self.processes.append(process)
        return process

    def submit(self, job_id: str, kind: str, **request: Any) -> Job:
        request |= {"marks": str(self.marks), "gate": str(self.gate)}
        return self.jobs.submit(Job(job_id, "tenant", "key", kind, State.QUEUED, request))

    def task(self, job_id: str, task: str, **arguments: Any) -> Job:
        return self.submit(job_id, "task", task=task, arguments=arguments)

    def job(self, job_id: str) -> Job:
        job = self.jobs.get("tenant", job_id)
        assert job is not None
        return job

    def ended(self, job_id: str, seconds: float = 20) -> Job:
        """The job, once it is final."""
        self.wait(lambda: self.job(job_id).state in FINAL, seconds)
        return self.job(job_id)

    def wrote(self, job_id: str) -> list[str]:
        lines = [line.split(" ", 1) for line in self.marks.read_text().splitlines()]
        return [line for owner, line in lines if owner == job_id]

    def wait(self, true: Callable[[], Any], seconds: float = 30) -> None:
        deadline = time.monotonic() + seconds
        while not true():
            if time.monotonic() > deadline:
                pytest.fail(f"did not come true within {seconds} s; the workers said:\n{self.log.read_text()}")
            time.sleep(0.02)

    def close(self) -> None:
        for process in self.processes:
            if process.poll() is None:
                process.kill()
            process.wait()
            process.stdin.close()  # type: ignore[union-attr]


@pytest.fixture
def workshop(settings: Settings, jobs: DurableJobs, tmp_path: Path) -> Iterator[Workshop]:
    shop = Workshop(settings, jobs, tmp_path)
    yield shop
    shop.close()
