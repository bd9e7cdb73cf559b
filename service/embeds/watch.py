"""Watching for owners: after an upload was marked, a job of the service's own looks for other owners' marks in it.

The uploader's job has ended by then, so nothing that its answer holds, and no time that it took, depends on what is
found. Nor does how long the uploader's next job waits for a worker: when this one runs is drawn. Nothing is written
into the audit log, whose size every claim shows.
"""

import json
from itertools import groupby
from random import SystemRandom

import sqlalchemy as sa

from service.clock import ago, now
from service.core import Service
from service.db.schema import FOUND, assets, notices
from service.embeds.screening import carried, choose, resembling
from service.jobs.durable_jobs import announce
from service.jobs.port import Ending, Flow, Job, Run, State, Step
from service.processes import Reply

NO_TENANT = ""
"""Tenant of these jobs: no API key sees them."""


def watch(service: Service, job: Job, asset_id: str) -> None:
    """Queue a look at what an embed job marked; twice is once."""
    request = {"model": job.request["model"], "tenant": job.tenant, "asset": asset_id}
    request |= {"spz_frame": job.request.get("spz_frame", "auto"), "names": job.request.get("names")}
    hours = SystemRandom().uniform(0.0, service.settings.watch_minutes / 60.0)
    service.jobs.submit(Job(f"watch_{asset_id}", NO_TENANT, "", "watch", State.QUEUED, request, created_at=ago(-hours)))


def watch_flow(service: Service) -> Flow:
    """Steps of such a job."""
    return (Step("watch", lambda run: _look(service, run)), Step("commit", lambda run: _notify(service, run)))


def _look(service: Service, run: Run) -> Reply:
    """No owner key enters a process that reads the upload."""
    request = run.job.request
    model = service.local_model(request, run)
    alike = resembling(service, run, model, assets.c.tenant != request["tenant"])
    chosen = choose(alike)
    return {"carries": carried(service, run, chosen), "not_screened": len(alike) - len(chosen)}


def _notify(service: Service, run: Run) -> Ending:
    """One notice for each recognised original, about its copy with the strongest evidence; and its owner's webhooks."""
    found = {each["asset"]: each for each in run.results["watch"]["carries"]}
    with service.db.write() as connection:
        rows = connection.execute(sa.select(assets).where(assets.c.id.in_(found))).all()
        # Of an original's copies, one that is named by itself counts most.
        rows = sorted(rows, key=lambda row: (row.tenant, row.original_sha256, -(found[row.id].get("copy_z") or 0.0)))
        notified = [next(copies) for _, copies in groupby(rows, key=lambda row: (row.tenant, row.original_sha256))]
        for number, row in enumerate(notified):
            notice = f"no_{run.job.request['asset'].removeprefix('as_')}_{number}"
            if connection.execute(sa.select(notices.c.id).where(notices.c.id == notice)).first() is None:
                values = {"id": notice, "tenant": row.tenant, "asset": row.id, "created_at": now()}
                values |= {"upload": run.job.request["asset"], "finding": json.dumps(found[row.id])}
                connection.execute(notices.insert().values(values))
                announce(connection, FOUND, row.tenant, notice)
    return {"state": State.SUCCEEDED, "result": {"notices": len(notified)}}
