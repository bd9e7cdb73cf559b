"""The steps of a verify job: compare the suspect with the records, then sign the claim."""

import sqlalchemy as sa

from service.asset_screening import screen
from service.claims.document import of_what_was_found
from service.claims.issuing import issue
from service.core import Service
from service.db import own
from service.db.schema import assets
from service.http.budgets import spend_subject
from service.jobs.port import Ending, Flow, Run, State, Step
from service.problems import Problem
from service.processes import Reply


def verify_flow(service: Service) -> Flow:
    """Steps of a verify job."""
    return (Step("verify", lambda run: _verify(service, run)), Step("commit", lambda run: _commit(service, run)))


def count_asset(service: Service, tenant: str, asset_id: str) -> None:
    """Count one verification of a suspect that derives from an asset."""
    original = own(service.db, assets, tenant, asset_id).original_sha256
    spend_subject(service, tenant, original, "verifications of suspects that derive from one original")


def _verify(service: Service, run: Run) -> Reply:
    request = run.job.request
    query = sa.select(assets).where(assets.c.tenant == run.job.tenant).order_by(assets.c.registered_at.desc())
    if request["asset_id"] is not None:
        query = query.where(assets.c.id == request["asset_id"])
    rows = service.db.query(query).all()
    if not rows:
        raise Problem("conflict", "no asset is registered, so there is nothing to compare the suspect with")
    suspect = {
        **service.local_model(request, run),
        "images": [service.local(digest, run) for digest in request["images"]],
    }
    originals = {row.original_sha256 for row in rows}
    chosen = rows if len(originals) == 1 else screen(service, run, suspect, rows, likely=True)
    known = service.candidates(chosen or rows[:1], run)
    if not known:
        raise Problem("conflict", "the owner key of every asset in question was erased: import it again")
    return service.do_task(
        run,
        "verify",
        {
            **suspect,
            "cameras": service.local(request["cameras"], run),
            "candidates": known,
            "stop_at_first": True,
            "suspect_seen": request.get("suspect_seen"),
            "suspect_existed": request.get("suspect_existed"),
            **{name: request[name] for name in ("false_claim_rate", "route")},
        },
    ) | {"searched": {"scope": "all" if request["asset_id"] is None else "one", "assets": len(rows)}}


def _commit(service: Service, run: Run) -> Ending:
    """Sign and keep the claim; a second time finds it."""
    job = run.job
    before = {"searched": {"scope": "one" if job.request["asset_id"] else "all", "assets": 1}}  # a step of version 2
    found = of_what_was_found({**before, **run.results["verify"]})
    if job.request["asset_id"] is None and found["searched"]["recognised"]:
        count_asset(service, job.tenant, found["asset"])
    return {"state": State.SUCCEEDED, "result": issue(service, job, found)}
