"""The steps of an embed job: mark the upload and register it.

The answer to the uploader depends on the uploader's own assets alone. A later job of the service (`watch`) looks for
the marks of other owners in the upload and notifies those owners.
"""

import json
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, TypedDict

import sqlalchemy as sa

from service.clock import now
from service.core import Service
from service.db.schema import assets
from service.embeds.screening import carried, choose, resembling
from service.embeds.watch import watch
from service.http.budgets import spend
from service.jobs.port import Ending, Flow, Job, Run, State, Step
from service.processes import Reply
from service.trust.commitments import commit_asset
from service.trust.draws import draws_for, stamp_to_draw
from service.trust.owner_keys import open_key

HELD = (
    "Registered. Marks of other owners are looked for in uploads; what is found is reported to these owners, and the"
    " asset may be held for review. This text is the same for every upload."
)


MEASURED = ("psnr_worst_view", "psnr_total_worst_view", "psnr_as_written", "ssim_worst_view", "seconds")


class Screening(TypedDict):
    """Which of the uploader's own marks an upload carries."""

    carries: Sequence[Mapping[str, Any]]
    not_screened: int  # own copies that the upload resembles and that were not looked for


def embed_flow(service: Service) -> Flow:
    """Steps of an embed job."""
    return (Step("embed", lambda run: _embed(service, run)), Step("commit", lambda run: _commit(service, run)))


def _embed(service: Service, run: Run) -> Reply:
    """Look for the uploader's own marks in the upload, and mark it. Files are kept by digest.

    No owner key but the one that marks enters a process that reads the upload.
    """
    request = run.job.request
    owner = open_key(service.db, service.master, run.job.tenant, request["key_id"])
    model = service.local_model(request, run)
    screening = _screen(service, run, model)
    draws = draws_for(service.settings)
    return service.do_task(
        run,
        "embed",
        {
            **model,
            "cameras": service.local(request["cameras"], run),
            "key": owner.secret.hex(),
            "bits": request["bits"] or 32,
            "copy": request["copy_name"],
            "registered_at": run.job.created_at[:19] + "+00:00",
            "draws": draws,
            "earlier": _earlier(service, run),
            **{name: request[name] for name in ("message", "profile", "psnr", "budget", "output", "format")},
            "survive": request.get("survive"),  # a job of before has none
        },
        partial(stamp_to_draw, service.db, service.settings) if draws else None,
    ) | {"screening": screening}


def _screen(service: Service, run: Run, model: Mapping[str, Any]) -> Screening:
    """Look for the marks of this tenant's assets, and count an upload that resembles one: many slight changes of one
    model are how a mark is tried out. All such uploads count towards the one that was registered first."""
    tenant = run.job.tenant
    alike = resembling(service, run, model, assets.c.tenant == tenant)
    if alike:
        first = min(alike, key=lambda row: row.registered_at)
        limit = service.settings.subject_embeds_per_day
        spend(service.db, f"family:{tenant}:{first.original_sha256}", limit, 24, "embed jobs of uploads that are alike")
    chosen = choose(alike)
    return {"carries": carried(service, run, chosen), "not_screened": len(alike) - len(chosen)}


def _earlier(service: Service, run: Run) -> str:
    """Where the record of the newest copy of this model under this key lies, "" if there is none: what was drawn for it
    holds for all copies, which share a layer; and it saves time."""
    request = run.job.request
    mine = (assets.c.tenant == run.job.tenant) & (assets.c.owner_key == request["key_id"])
    query = sa.select(assets.c.record_sha256).where(mine & (assets.c.original_sha256 == request["model"]))
    row = service.db.query(query.order_by(assets.c.registered_at.desc())).first()
    return "" if row is None else service.local_or_gone(row.record_sha256, run)


def _commit(service: Service, run: Run) -> Ending:
    """Write everything the job made in one transaction; a second time changes nothing."""
    job, made = run.job, run.results["embed"]
    with service.db.exclusive() as connection:  # so that the log's times follow one another
        row = _row(job, made, now())
        if connection.execute(sa.select(assets.c.id).where(assets.c.id == row["id"])).first() is None:
            connection.execute(assets.insert().values(**row))
            commit_asset(connection, row, made.get("drawn", ""), row["registered_at"])
    watch(service, job, row["id"])
    report = made["report"]
    result = {
        "asset_id": row["id"],
        **{name: row[name] for name in ("record_id", "message", "gaussians")},
        **{name: report[name] for name in MEASURED if name in report},  # a step of before has no psnr_as_written
        "already_carries": [found["asset"] for found in made["screening"]["carries"]],
        "not_screened": made["screening"].get("not_screened", 0),  # a step of before has none
        "review": HELD,
    }
    return {"state": State.SUCCEEDED, "result": result}


def _row(job: Job, made: Mapping[str, Any], registered_at: str) -> dict[str, str]:
    request, kept = job.request, made["kept"]
    return {
        "id": "as_" + job.id.removeprefix("job_"),
        "tenant": job.tenant,
        "job": job.id,
        "owner_key": request["key_id"],
        "label": request["label"] or ", ".join(request.get("names") or ())[:200],
        "copy": request["copy_name"],
        **{name: made[name] for name in ("record_id", "message", "original_format")},
        "profile": request["profile"],
        "report": json.dumps(made["report"]),
        "gaussians": made["report"]["gaussians_out"],
        "original_sha256": request["model"],
        "model_format": made["format"],
        **{f"{name}_sha256": kept[name] for name in ("model", "record", "preview", "sketch")},
        "registered_at": registered_at,
    }
