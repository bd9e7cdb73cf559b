"""Trace copies: which recipients' copies took part in a suspect?"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from engine.errors import InputError
from engine.usecases.files import read_bytes

if TYPE_CHECKING:
    from engine.flows.progress import Progress
    from engine.flows.records.opened_record import OpenedRecord
    from engine.flows.trace.tracing import Tracing
    from engine.flows.verify.decision import VerifyConfig
    from engine.usecases.suspect import ReadSuspect, SuspectSource
    from engine.watermark.keys import OwnerKey

__all__ = ["TraceAnswer", "TraceRequest", "trace"]


@dataclass(frozen=True, eq=False, kw_only=True)
class TraceRequest:
    """Whose copies are looked for, and where; InputError where there is no record."""

    suspect: SuspectSource
    records: Sequence[Path]  # record files, opened one at a time, as often as they are needed
    key: OwnerKey  # of all records
    config: VerifyConfig

    def __post_init__(self) -> None:
        if not self.records:
            raise InputError("no record was given")

    def __iter__(self) -> Iterator[OpenedRecord]:
        """The records, each opened when its turn comes."""
        from engine.flows.records.opened_record import open_record

        return (open_record(read_bytes(file, "record"), self.key) for file in self.records)


@dataclass(frozen=True, eq=False)
class TraceAnswer:
    """The result of a tracing."""

    read: ReadSuspect
    tracing: Tracing
    seconds: float


def trace(
    request: TraceRequest, progress: Progress, prepare: Callable[[ReadSuspect], None] | None = None
) -> TraceAnswer:
    """Read the suspect, and every record once a route. Raises the errors of the suspect's files and of the records.

    Parameters
    ----------
    prepare : callable, optional
        Called with the suspect once it is read, before the work on it.
    """
    from engine.flows.trace.tracing import trace as trace_copies

    began = time.perf_counter()
    progress("read", 0.0)
    read = request.suspect.read()
    if prepare is not None:
        prepare(read)
    tracing = trace_copies(read.suspect, request, request.config, progress)
    return TraceAnswer(read, tracing, time.perf_counter() - began)
