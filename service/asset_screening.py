"""Which registered assets may a suspect come from? The index for that is kept in the data folder of each machine.

It is a convenience that can be lost: what it lacks is read from the assets' entries, and when that is much, it is
written anew. Copies of one original are one asset to it.
"""

from __future__ import annotations

import json
import secrets
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from service.core import Service
from service.db.schema import assets
from service.jobs.port import Run
from service.processes import Reply

__all__ = ["scores", "screen"]

MOST_MISSING = 32
"""Assets that the kept index may lack: every screening reads their entries anew."""
OUTGROWN = 8
"""An index is learnt anew from all entries when it holds so many times the assets from which it was."""


def screen(
    service: Service, run: Run, suspect: Mapping[str, Any], rows: Sequence[Any], *, likely: bool = False
) -> list[Any]:
    """The rows of `assets`, of those given, that a suspect (`model`, or `images`) may come from, the likeliest first.

    These are the alike ones or, without any and if `likely`, the few likeliest. Assets whose entry cannot be read or is
    empty are added: nothing rules them out. Where there are any, and the suspect names a `plain` file, its model lies
    under that name in the step's folder.
    """
    if not rows:
        return []
    found = _ask(service, run, suspect, rows)
    chosen = [*(found["alike"] or (found["likely"] if likely else ())), *found["unknown"]]
    order = {original: number for number, original in reversed(list(enumerate(chosen)))}
    return sorted((row for row in rows if row.original_sha256 in order), key=lambda row: order[row.original_sha256])


def scores(service: Service, run: Run, suspect: Mapping[str, Any], rows: Sequence[Any]) -> dict[str, int]:
    """Score (50 or 100) of each alike original of these rows; nothing of those that cannot be compared."""
    return dict(_ask(service, run, suspect, rows)["scores"]) if rows else {}


def _ask(service: Service, run: Run, suspect: Mapping[str, Any], rows: Sequence[Any]) -> Reply:
    """The reply of the task `screen`; the kept index is renewed first where it lacks much."""
    folder = service.settings.data_dir / "catalogue"
    newest = sa.select(assets.c.original_sha256, assets.c.sketch_sha256).order_by(assets.c.registered_at)
    entries = {row.original_sha256: row.sketch_sha256 for row in service.db.query(newest)}  # the last one counts
    kept, known = _kept(folder)
    if len(entries.keys() - known) > MOST_MISSING:
        kept, known = _write(service, run, folder, kept, known, entries)
    return run.work(
        "screen",
        {
            **suspect,
            "catalogue": str(kept or ""),
            "entries": _paths(service, run, entries, known),
            "among": sorted({row.original_sha256 for row in rows}),
        },
    )


def _kept(folder: Path) -> tuple[Path | None, set[str]]:
    """The fullest index that is there, and the originals in it."""
    best: tuple[Path | None, set[str]] = (None, set())
    for path in folder.glob("index-*"):
        try:
            names = set(json.loads((path / "assets.json").read_text())["names"])
        except (OSError, ValueError, KeyError):  # being taken away, or damaged
            continue
        if len(names) > len(best[1]):
            best = path, names
    return best


def _write(
    service: Service, run: Run, folder: Path, kept: Path | None, known: set[str], entries: Mapping[str, str]
) -> tuple[Path, set[str]]:
    if kept is None or len(entries) >= OUTGROWN * int(kept.name.split("-")[1]):
        kept, known = None, set()
    learnt = len(entries) if kept is None else int(kept.name.split("-")[1])
    made = run.work("index", {"catalogue": str(kept or ""), "entries": _paths(service, run, entries, known)})
    folder.mkdir(mode=0o700, exist_ok=True)
    path = folder / f"index-{learnt}-{secrets.token_hex(8)}"
    before = list(folder.glob("index-*"))
    shutil.move(run.folder / made["folder"], path)
    for old in before:
        shutil.rmtree(old, ignore_errors=True)
    return path, set(json.loads((path / "assets.json").read_text())["names"])


def _paths(service: Service, run: Run, entries: Mapping[str, str], known: set[str]) -> dict[str, str]:
    """Where the entries lie that an index lacks; "" where one is not to be had."""
    return {name: service.local_or_gone(digest, run) for name, digest in entries.items() if name not in known}
