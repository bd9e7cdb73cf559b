"""The steps of an embed job: mark the upload unless it carries another's mark, and register it."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, TypedDict

import sqlalchemy as sa

from service.asset_screening import screen
from service.clock import now
from service.core import Service
from service.db.schema import assets
from service.jobs.port import Ending, Flow, Job, Run, State, Step
from service.processes import Reply
from service.trust import audit
from service.trust.commitments import commit_asset
from service.trust.draws import draws_for, stamp_to_draw
from service.trust.owner_keys import open_key

PLAIN = "plain.ply"
"""In a step's folder: a suspect model, written anew by a process without keys, for one that has them."""
SCREENED = 1024
"""Copies of assets that an upload resembles and that are looked for in it, at most; each takes a tenth of a second."""


class Screening(TypedDict):
    """Whose marks an upload carries."""

    carries: Sequence[Mapping[str, Any]]
    disputed: bool  # one of them is another's
    not_screened: int  # copies that the upload resembles and that were not looked for


def embed_flow(service: Service) -> Flow:
    """Steps of an embed job."""
    return (Step("embed", lambda run: _embed(service, run)), Step("commit", lambda run: _commit(service, run)))


def _embed(service: Service, run: Run) -> Reply:
    """Look for registered marks in the upload; where no other owner's is found, mark it. Files are kept by digest.

    No owner key but the one that marks enters a process that reads the upload.
    """
    asked = run.job.request
    owner = open_key(service.db, service.master, run.job.tenant, asked["key_id"])
    model = {"model": service.local(asked["model"], run), "spz_frame": asked["spz_frame"]}
    screening = _screen(service, run, model)
    if screening["disputed"]:
        return {"screening": screening, "kept": {}}
    draws = draws_for(service.settings)
    return service.do_task(
        run,
        "embed",
        {
            **model,
            "cameras": service.local(asked["cameras"], run),
            "key": owner.secret.hex(),
            "bits": asked["bits"] or 32,
            "copy": asked["copy_name"],
            "registered_at": run.job.created_at[:19] + "+00:00",
            "draws": draws,
            "earlier": _earlier(service, run),
            **{name: asked[name] for name in ("message", "profile", "psnr", "budget", "output", "format")},
        },
        partial(stamp_to_draw, service.db, service.settings) if draws else None,
    ) | {"screening": screening}


def _screen(service: Service, run: Run, model: Mapping[str, Any]) -> Screening:
    """Look for the marks of others' and of this tenant's assets.

    An asset made from this very file is left out: the file is its unmarked original.
    """
    query = sa.select(assets).where(assets.c.original_sha256 != run.job.request["model"])
    rows = service.db.query(query.order_by(assets.c.registered_at.desc())).all()
    alike = screen(service, run, {**model, "plain": PLAIN}, rows)
    chosen = choose(alike, run.job.tenant)
    known = service.candidates(chosen, run)
    asked = {"model": str(run.folder / PLAIN), "candidates": known}
    found = run.work("marks", asked)["carries"] if known else []
    mine = {row.id for row in chosen if row.tenant == run.job.tenant}
    return {
        "carries": found,
        "disputed": any(each["asset"] not in mine for each in found),
        "not_screened": len(alike) - len(chosen),
    }


def choose(alike: Sequence[Any], tenant: str) -> list[Any]:
    """At most SCREENED rows of `assets`, those of one original next to each other.

    Owners take turns, others before the tenant that asks, and so do the originals of each: a copy cannot be hidden
    behind many of the same owner.
    """
    seen: Counter[Any] = Counter()

    def turn(of: Any) -> int:
        seen[of] += 1
        return seen[of]

    by_copy = sorted(alike, key=lambda row: turn((row.tenant, row.original_sha256)))
    chosen = sorted(by_copy, key=lambda row: (turn(row.tenant), row.tenant == tenant))[:SCREENED]
    order = {row.original_sha256: number for number, row in reversed(list(enumerate(alike)))}
    ids = {row.id for row in chosen}
    return sorted((row for row in alike if row.id in ids), key=lambda row: order[row.original_sha256])


def _earlier(service: Service, run: Run) -> str:
    """Where the record of the newest copy of this model under this key lies, "" if there is none: what was drawn for it
    holds for all copies, which share a layer; and it saves time."""
    asked = run.job.request
    mine = (assets.c.tenant == run.job.tenant) & (assets.c.owner_key == asked["key_id"])
    query = sa.select(assets.c.record_sha256).where(mine & (assets.c.original_sha256 == asked["model"]))
    row = service.db.query(query.order_by(assets.c.registered_at.desc())).first()
    return "" if row is None else service.local_or_gone(row.record_sha256, run)


def _commit(service: Service, run: Run) -> Ending:
    """Write everything the job made in one transaction; a second time changes nothing."""
    job, made = run.job, run.results["embed"]
    if not made["kept"]:
        with service.db.write() as connection:
            payload = {"original_sha256": job.request["model"]}
            if audit.find(connection, "embed.disputed", job.id) is None:
                audit.append(connection, job.tenant, "embed.disputed", payload, job.id)
        text = (
            "This model already carries a mark that another party registered here. It was not marked again. If you"
            " made it, mark your original, which carries no mark, and start a dispute between the two"
            " (POST /v1/disputes): no date decides that, but whose mark is in the other's original."
        )
        return {"state": State.DISPUTED, "result": {"text": text}}
    with service.db.exclusive() as connection:  # so that the log's times follow one another
        row = _row(job, made, now())
        if connection.execute(sa.select(assets.c.id).where(assets.c.id == row["id"])).first() is None:
            connection.execute(assets.insert().values(**row))
            commit_asset(connection, row, made.get("drawn", ""), row["registered_at"])
    report = made["report"]
    result = {
        "asset_id": row["id"],
        **{name: row[name] for name in ("record_id", "message", "gaussians")},
        **{name: report[name] for name in ("psnr_worst_view", "ssim_worst_view", "seconds")},
        "already_carries": [found["asset"] for found in made["screening"]["carries"]],
        "not_screened": made["screening"].get("not_screened", 0),  # a step of before has none
    }
    return {"state": State.SUCCEEDED, "result": result}


def _row(job: Job, made: Mapping[str, Any], registered_at: str) -> dict[str, str]:
    asked, kept = job.request, made["kept"]
    return {
        "id": "as_" + job.id.removeprefix("job_"),
        "tenant": job.tenant,
        "job": job.id,
        "owner_key": asked["key_id"],
        "label": asked["label"],
        "copy": asked["copy_name"],
        **{name: made[name] for name in ("record_id", "message", "original_format")},
        "profile": asked["profile"],
        "report": json.dumps(made["report"]),
        "gaussians": made["report"]["gaussians_out"],
        "original_sha256": asked["model"],
        "model_format": made["format"],
        **{f"{name}_sha256": kept[name] for name in ("model", "record", "preview", "sketch")},
        "registered_at": registered_at,
    }
