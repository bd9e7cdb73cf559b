"""Marks that an upload carries already: which assets it resembles, and which of their marks it shows."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import sqlalchemy as sa

from service.asset_screening import screen
from service.core import Service
from service.db.schema import assets
from service.jobs.port import Run

PLAIN = "plain.ply"
"""In a step's folder: a suspect model, written anew by a process without keys, for one that has them."""
SCREENED = 1024
"""Copies of assets that an upload resembles and that are looked for in it, at most; each takes a tenth of a second."""


def resembling(service: Service, run: Run, model: Mapping[str, Any], whose: sa.ColumnElement[bool]) -> list[Any]:
    """Rows of `assets` that an upload may come from, the likeliest first.

    An asset made from this very file is left out: the file is its unmarked original.
    """
    query = sa.select(assets).where(whose, assets.c.original_sha256 != run.job.request["model"])
    rows = service.db.query(query.order_by(assets.c.registered_at.desc())).all()
    return screen(service, run, {**model, "plain": PLAIN}, rows)


def carried(service: Service, run: Run, chosen: Sequence[Any]) -> list[Mapping[str, Any]]:
    """Those whose mark the upload shows; its model lies in the step's folder."""
    known = service.candidates(chosen, run)
    request = {"model": str(run.folder / PLAIN), "candidates": known}
    return list(run.work("marks", request)["carries"]) if known else []


def choose(alike: Sequence[Any]) -> list[Any]:
    """At most SCREENED rows of `assets`, those of one original next to each other.

    Owners take turns, and so do the originals of each: a copy cannot be hidden behind many of the same owner.
    """
    seen: Counter[Any] = Counter()

    def turn(of: Any) -> int:
        seen[of] += 1
        return seen[of]

    by_copy = sorted(alike, key=lambda row: turn((row.tenant, row.original_sha256)))
    ids = {row.id for row in sorted(by_copy, key=lambda row: turn(row.tenant))[:SCREENED]}
    order = {row.original_sha256: number for number, row in reversed(list(enumerate(alike)))}
    return sorted((row for row in alike if row.id in ids), key=lambda row: order[row.original_sha256])
