"""The steps of a dispute: compare two assets, then log and sign the finding."""

from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import sqlalchemy as sa

from engine.records.signatures import DISPUTE
from service.clock import now
from service.core import Service
from service.db.schema import assets
from service.jobs.port import Ending, Flow, Run, State, Step
from service.problems import Problem
from service.processes import Reply
from service.trust import audit
from service.trust.canonical import canonical, digest
from service.trust.signing import sign

SETTLED = "dispute.settled"
SCHEMA_VERSION = 1


def dispute_flow(service: Service) -> Flow:
    """Steps of a dispute job."""
    return (Step("dispute", lambda run: _settle(service, run)), Step("commit", lambda run: _commit(service, run)))


def _settle(service: Service, run: Run) -> Reply:
    """Look for both marks in both originals and both published models."""
    ids = run.job.request["assets"]
    rows = {row.id: row for row in service.db.query(assets.select().where(assets.c.id.in_(ids)))}
    if len(rows) < len(ids):
        raise Problem("conflict", "an asset in question is gone")
    known = {each["asset"]: each for each in service.candidates([rows[name] for name in ids], run)}
    if len(known) < len(ids):
        raise Problem("conflict", "the owner key of an asset in question was erased: import it again")
    parties = [{**known[name], "model": service.local(rows[name].model_sha256, run)} for name in ids]
    return service.do_task(run, "dispute", {"parties": parties})


def _commit(service: Service, run: Run) -> Ending:
    """Log and sign the finding, in one transaction; a second time finds the entry."""
    dispute_id = "di_" + run.job.id.removeprefix("job_")
    document: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "dispute_id": dispute_id,
        "created_at": now(),
        "tool": {"name": "mark3dgs", "version": version("mark3dgs")},
        "assets": dict(zip("ab", run.job.request["assets"], strict=True)),
        "finding": run.results["dispute"]["finding"],
    }
    with service.db.exclusive() as connection:
        document["audit"] = _logged(connection, run.job.tenant, document)
        document["created_at"] = document["audit"]["entry"]["at"]
        jws = sign(connection, service.master, canonical(document), DISPUTE)
    result = {"dispute_id": dispute_id, "first": document["finding"]["first"], "document": document, "jws": jws}
    return {"state": State.SUCCEEDED, "result": result}


def _logged(connection: sa.Connection, tenant: str, document: Mapping[str, Any]) -> Mapping[str, Any]:
    """The log's entry about a finding, and the proof that it is in the log."""
    entry = audit.find(connection, SETTLED, document["dispute_id"])
    if entry is None:
        payload = {"assets": document["assets"], "digest": digest(document["finding"])}
        entry = audit.append(connection, tenant, SETTLED, payload, document["dispute_id"])
    return {"index": entry.index, **audit.proven(connection, entry)}
