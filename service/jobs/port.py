"""The port: what the service asks of a job engine. Behind it stand DBOS (`durable`) and, in tests, a plain fake."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Protocol


class State(StrEnum):
    """Where a job stands. The last four are final."""

    QUEUED = "queued"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    DISPUTED = "disputed"
    FAILED = "failed"
    CANCELLED = "cancelled"


FINAL = frozenset({State.SUCCEEDED, State.DISPUTED, State.FAILED, State.CANCELLED})


@dataclass(frozen=True)
class Job:
    """One job as it stands.

    Parameters
    ----------
    id, tenant, api_key : str
        `api_key` is the public id of the key that asked for it.
    kind : str
        Key of the flows: "embed" or "verify".
    request : mapping
        What was asked, JSON values; never a secret.
    stage, fraction : str, float
        What it is doing, and how far that is, 0 to 1.
    result : mapping or None
        Once succeeded or disputed.
    problem : mapping or None
        RFC 9457 object, once failed.
    revision : int
        Grows with every change; the ETag.
    cancelling : bool
        Cancellation was asked for.
    created_at, started_at, finished_at : str
        UTC, ISO 8601; empty while not yet.
    """

    id: str
    tenant: str
    api_key: str
    kind: str
    state: State
    request: Mapping[str, Any]
    stage: str = ""
    fraction: float = 0.0
    result: Mapping[str, Any] | None = None
    problem: Mapping[str, Any] | None = None
    revision: int = 0
    cancelling: bool = False
    created_at: str = ""
    started_at: str = ""
    finished_at: str = ""


class Jobs(Protocol):
    """A job engine."""

    def submit(self, job: Job) -> Job:
        """Take a job on; when this returns, it will be done whatever dies. The same id twice is one job."""

    def get(self, tenant: str, job_id: str) -> Job | None:
        """The job, if it is this tenant's."""

    def list(self, tenant: str, limit: int = 20, after: str = "") -> Sequence[Job]:
        """Jobs of a tenant, newest first, after the job with this id."""

    def cancel(self, tenant: str, job_id: str) -> Job | None:
        """Ask for a job to stop. A final job stays as it is."""

    def progress(self, job_id: str, stage: str, fraction: float) -> bool:
        """Say how far a job is. False: cancellation was asked for (or the job is gone); stop."""

    def result(self, job_id: str, state: State, value: Mapping[str, Any]) -> None:
        """End a job: `value` is its result, or its problem where it failed. A final job stays as it is."""

    def recover(self, silent_seconds: float) -> Sequence[str]:
        """Take over the jobs of workers not heard of for that long; ids of those workers."""


@dataclass
class Run:
    """What a step of a flow is handed.

    Parameters
    ----------
    results : dict
        What the steps before returned, by step name.
    folder : Path
        An empty scratch folder of this step, removed after it.
    work : callable
        `work(task, request) -> reply`: runs a task of `service.work` in a process of its own, with limits; progress
        goes to the job, a cancelled job raises `Cancelled`, an error of the engine raises the `Problem` it means.
        Files that the task makes lie in `folder`.
    """

    job: Job
    results: dict[str, Any] = field(default_factory=dict)
    folder: Path = Path()
    work: Callable[[str, Mapping[str, Any]], dict[str, Any]] = lambda task, request: {}


class Cancelled(Exception):
    """The job was cancelled while it ran."""


@dataclass(frozen=True)
class Step:
    """One step of a flow: its name, and what it does. Its result (JSON values) is kept: it never runs again."""

    name: str
    do: Callable[[Run], dict[str, Any]]


Flow = tuple[Step, ...]
"""The last step's result must hold `state` (of State) and `result`; it has committed what the job made."""
