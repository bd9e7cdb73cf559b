"""A look at a complete upload: a file that cannot be read is refused at once, not minutes later by a job."""

from typing import Any

from service.core import Service
from service.jobs.once import run_once, task_folder
from service.problems import Problem
from service.uploads import store

MOST_BYTES = 256 << 20
"""Larger files are read by their job only."""


def inspect(service: Service, row: Any) -> Any:
    """The row with what the file is. What takes too long to say is left to the job.

    Raises
    ------
    Problem
        unreadable-model and the like: the upload is dropped.
    """
    with task_folder(service.settings) as folder:
        path = service.blobs.local(row.sha256, folder)
        with path.open("rb") as file:
            kind = store.kind_of(file.read(16))
        if row.size > MOST_BYTES:
            return store.note(service, row, {"kind": kind})
        request = {kind: str(path), "spz_frame": "auto"}
        task = "inspect" if kind == "model" else kind
        try:
            found = run_once(service.settings, task, request, folder, service.settings.inspect_seconds)
        except Problem as problem:
            if problem.status < 500:
                store.drop(service, row)
            raise
        if found is None:
            return store.note(service, row, {"kind": kind})
    names = ("format", "gaussians", "sh_degree", "repairs", "width", "height", "cameras")
    info = {"kind": kind, **{name: found[name] for name in names if name in found}}
    return store.note(service, row, info)
