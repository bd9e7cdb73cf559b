"""The process that does the jobs: flows of all kinds, one job at a time; webhooks, and tidying up now and then."""

import logging
import threading
import time
from typing import NoReturn

import sqlalchemy.orm  # noqa: F401  here: two threads that first need it at one time find it half loaded

from service.claims import shares
from service.core import Service
from service.disputes.flow import dispute_flow
from service.embeds.flow import embed_flow
from service.embeds.watch import watch_flow
from service.http.budgets import forget
from service.jobs.runner import Worker
from service.uploads.retention import sweep
from service.verifications.flow import verify_flow
from service.webhooks.delivery import deliver_for_ever

TIDY_SECONDS = 3600.0
log = logging.getLogger("mark3dgs.worker")


def run_worker(service: Service, name: str, die_with_parent: bool) -> NoReturn:
    """Do jobs until stopped; ends the process."""
    for task in (_tidy, deliver_for_ever):
        threading.Thread(target=task, args=(service,), daemon=True).start()
    flows = {"embed": embed_flow(service), "verify": verify_flow(service), "dispute": dispute_flow(service)}
    flows["watch"] = watch_flow(service)
    Worker(service.settings, flows, service.jobs, name=name, die_with_parent=die_with_parent).run()


def _tidy(service: Service) -> None:
    while True:
        time.sleep(TIDY_SECONDS)
        try:
            sweep(service)
            shares.sweep(service.db)
            forget(service.db)
            service.jobs.prune(24 * service.settings.job_days)
        except Exception as error:  # the jobs matter more; the next hour tries again
            log.warning("tidying up failed: %s", error)
