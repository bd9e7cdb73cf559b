"""Registered assets as the tasks take them: what a suspect, or an upload, is held against."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from service.core import Service
from service.problems import Problem
from service.trust.owner_keys import open_key


def candidates(core: Service, rows: Sequence[Any], folder: Path) -> list[dict[str, Any]]:
    """Assets with paths that can be read, and their owner keys, which go through a pipe only.

    An asset whose owner key was erased cannot be looked for: it is left out.

    Parameters
    ----------
    rows : sequence of rows of the table `assets`
    folder : Path
        For copies of blobs that are not on this machine.
    """
    found = []
    for row in rows:
        try:
            key = open_key(core.db, core.master, row.tenant, row.owner_key)
        except Problem as problem:
            if problem.kind != "not-found":
                raise
            continue
        found.append(
            {
                "asset": row.id,
                "record": str(core.blobs.local(row.record_sha256, folder)),
                "sketch": str(core.blobs.local(row.sketch_sha256, folder)),
                "key": key.secret.hex(),
            }
        )
    return found
