"""Jobs, their states, and the steps that do them, whatever the engine behind (`durable_jobs`: DBOS)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, TypedDict

from service.processes import Reply


class State(StrEnum):
    """State of a job. The last four are final."""

    QUEUED = "queued"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    DISPUTED = "disputed"
    FAILED = "failed"
    CANCELLED = "cancelled"


FINAL = frozenset({State.SUCCEEDED, State.DISPUTED, State.FAILED, State.CANCELLED})


@dataclass(frozen=True)
class Job:
    """One job and its state."""

    id: str
    tenant: str
    api_key: str  # public id of the key that requested it
    kind: str  # embed, verify or dispute: key of the flows
    state: State
    request: Mapping[str, Any]  # JSON values; never a secret
    stage: str = ""  # what it is doing
    fraction: float = 0.0  # how far that is, 0 to 1
    result: Mapping[str, Any] | None = None  # once succeeded or disputed
    problem: Mapping[str, Any] | None = None  # once failed, as in RFC 9457
    revision: int = 0  # grows with every change; the ETag
    cancelling: bool = False  # cancellation was requested
    attempts: int = 0  # begun so often; a worker that holds an older number has lost the job
    tries: int = 0  # of these, at the present step; those that a shut-down ended do not count
    created_at: str = ""  # UTC, ISO 8601; empty while not yet, like the next two. Nothing begins before
    started_at: str = ""
    finished_at: str = ""


@dataclass
class Run:
    """What a step of a flow gets.

    `work(task, request, answer) -> reply` runs a task of `service.work` in a process of its own, with limits: progress
    goes to the job, `answer` answers its questions (None: it has none), a cancelled job raises `Cancelled`, an error of
    the engine the `Problem` it means. Files that it makes lie in `folder`.
    """

    job: Job
    results: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # of the steps before, by name
    folder: Path = Path()  # scratch of this step, empty, removed after it
    work: Callable[..., Reply] = lambda task, request, answer=None: {}


@dataclass(frozen=True)
class Step:
    """One step of a flow: its name, and what it does. Its result (JSON values) is kept: it never runs again."""

    name: str
    do: Callable[[Run], Mapping[str, Any]]


class Ending(TypedDict):
    """Result of a flow's last step, which has committed what the job made."""

    state: State
    result: Mapping[str, Any]


Flow = tuple[Step, ...]
"""The last step's result is an `Ending`."""
