"""The steps of a verify job: hold the suspect against the records, then sign the claim."""

from typing import Any

from service.claims.issuing import issue
from service.core import Service
from service.jobs.port import Flow, Run, State, Step
from service.problems import Problem
from service.registry import candidates
from service.verifications.candidates import rows_to_try, spend_subject


def verify_flow(service: Service) -> Flow:
    """Steps of a verify job."""
    return (Step("verify", lambda run: _verify(service, run)), Step("commit", lambda run: _commit(service, run)))


def _verify(service: Service, run: Run) -> dict[str, Any]:
    asked, folder = run.job.request, run.folder
    rows = rows_to_try(service, run.job.tenant, asked["asset_id"])
    if not rows:
        raise Problem("conflict", "no asset is registered, so there is nothing to hold the suspect against")
    known = candidates(service, rows, folder)
    if not known:
        raise Problem("conflict", "the owner key of every asset in question was erased: import it again")
    found = run.work(
        "verify",
        {
            "model": str(service.blobs.local(asked["model"], folder)) if asked["model"] else None,
            "images": [str(service.blobs.local(digest, folder)) for digest in asked["images"]],
            "cameras": str(service.blobs.local(asked["cameras"], folder)) if asked["cameras"] else None,
            "candidates": known,
            "stop_at_first": True,
            **{name: asked[name] for name in ("false_claim_rate", "route", "spz_frame")},
        },
    )
    kept = {name: service.blobs.put(folder / file) for name, file in found["files"].items()}
    return {**{name: value for name, value in found.items() if name != "files"}, "kept": kept}


def _commit(service: Service, run: Run) -> dict[str, Any]:
    """Sign and keep the claim; a second time finds it."""
    found, job = run.results["verify"], run.job
    claim = found["claim"]
    derived = claim is not None and (claim["verdict"] == "marked" or (claim["derived_fraction"] or 0.0) > 0.0)
    if job.request["asset_id"] is None and found["asset"] is not None and derived:
        spend_subject(service, found["asset"])
    return {"state": State.SUCCEEDED.value, "result": issue(service, job, found)}
