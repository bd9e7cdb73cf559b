"""The steps of an embed job: screen the upload against the registry, mark it, register it."""

from __future__ import annotations

import json
from typing import Any

import sqlalchemy as sa

from service.core import Service
from service.db.schema import assets, uploads
from service.jobs.port import Flow, Job, Run, State, Step
from service.registry import candidates
from service.trust import audit
from service.trust.commitments import commit_asset
from service.trust.owner_keys import open_key

SCREENED = 8
"""Registered assets that resemble an upload and are looked for in it, at most."""


def embed_flow(service: Service) -> Flow:
    """Steps of an embed job."""
    return (
        Step("screen", lambda run: _screen(service, run)),
        Step("embed", lambda run: _embed(service, run)),
        Step("commit", lambda run: _commit(service, run)),
    )


def _screen(service: Service, run: Run) -> dict[str, Any]:
    """Does the upload carry a mark that is registered already? Then say so, and name nothing of other tenants."""
    with service.db.read() as connection:
        rows = {
            row.id: row
            for row in connection.execute(sa.select(assets).order_by(assets.c.registered_at.desc()))
        }
        sketch = connection.execute(
            sa.select(uploads.c.sketch_sha256).where(uploads.c.id == run.job.request["upload_id"])
        ).scalar()
    if not rows:
        return {"carries": [], "screened": 0}
    found = run.work("inspect", {
        "model": str(service.blobs.local(run.job.request["model"], run.folder)),
        "spz_frame": run.job.request["spz_frame"],
        "sketch": str(service.blobs.local(sketch, run.folder)) if sketch else None,
        "candidates": candidates(service, list(rows.values()), run.folder),
        "limit": SCREENED,
    })  # fmt: skip
    carries = [entry["asset"] for entry in found["carries"]]
    return {
        "own": [asset for asset in carries if rows[asset].tenant == run.job.tenant],
        "foreign": sum(rows[asset].tenant != run.job.tenant for asset in carries),
        "screened": found["screened"],
    }


def _embed(service: Service, run: Run) -> dict[str, Any]:
    """Mark the model, and keep what came out by digest."""
    if run.results["screen"].get("foreign"):
        return {}
    asked, folder = run.job.request, run.folder
    owner = open_key(service.db, service.master, run.job.tenant, asked["key_id"])
    made = run.work("embed", {
        "model": str(service.blobs.local(asked["model"], folder)),
        "cameras": str(service.blobs.local(asked["cameras"], folder)) if asked["cameras"] else None,
        "key": owner.secret.hex(),
        "bits": asked["bits"] or 32,
        "copy": asked["copy_name"],
        "registered_at": run.job.created_at[:19] + "+00:00",
        **{name: asked[name] for name in ("message", "profile", "psnr", "budget", "output", "format", "spz_frame")},
    })  # fmt: skip
    kept = {name: service.blobs.put(folder / file) for name, file in made["files"].items()}
    return {**{name: value for name, value in made.items() if name != "files"}, "kept": kept}


def _commit(service: Service, run: Run) -> dict[str, Any]:
    """Write everything the job made in one transaction; a second time changes nothing."""
    job, screened = run.job, run.results["screen"]
    if screened.get("foreign"):
        with service.db.write() as connection:
            payload = {"original_sha256": job.request["model"]}
            if audit.find(connection, "embed.disputed", job.id) is None:
                audit.append(connection, job.tenant, "embed.disputed", payload, job.id)
        text = (
            "This model already carries a mark that another party registered here. It was not marked again. If you"
            " made it, show your original and your earlier registration; the audit log holds the time of both."
        )
        return {"state": State.DISPUTED.value, "result": {"text": text}}
    row = _row(job, run.results["embed"])
    with service.db.write() as connection:
        if connection.execute(sa.select(assets.c.id).where(assets.c.id == row["id"])).first() is None:
            connection.execute(assets.insert().values(**row))
            commit_asset(connection, row)
    report = run.results["embed"]["report"]
    result = {
        "asset_id": row["id"],
        "record_id": row["record_id"],
        "message": row["message"],
        "psnr_worst_view": report["psnr_worst_view"],
        "ssim_worst_view": report["ssim_worst_view"],
        "gaussians": row["gaussians"],
        "seconds": report["seconds"],
        "already_carries": screened.get("own", []),
    }
    return {"state": State.SUCCEEDED.value, "result": result}


def _row(job: Job, made: dict[str, Any]) -> dict[str, Any]:
    asked, kept = job.request, made["kept"]
    return {
        "id": "as_" + job.id.removeprefix("job_"),
        "tenant": job.tenant,
        "job": job.id,
        "owner_key": asked["key_id"],
        "label": asked["label"],
        "copy": asked["copy_name"],
        "record_id": made["record_id"],
        "message": made["message"],
        "profile": asked["profile"],
        "report": json.dumps(made["report"]),
        "gaussians": made["report"]["gaussians_out"],
        "original_sha256": asked["model"],
        "original_format": made["original_format"],
        "model_sha256": kept["model"],
        "model_format": made["format"],
        "record_sha256": kept["record"],
        "preview_sha256": kept["preview"],
        "sketch_sha256": kept["sketch"],
        "registered_at": job.created_at[:19] + "+00:00",
    }
