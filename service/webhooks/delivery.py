"""Delivery of messages to webhooks: at least once, repeated where that failed, but not for ever.

A pending message is a row of `deliveries`. The process that takes one moves its time on by a lease: should it die,
another takes the message then. Of each webhook a process takes one at a time: a slow receiver delays its own alone.

The address is one that a tenant chose: never in our own network (`service.open_network`), no redirects, no proxy, not
for long, and of the answer the status alone.
"""

from __future__ import annotations

import asyncio
import json
import logging
import time
from collections.abc import Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from importlib.metadata import version
from typing import Any, NoReturn

import httpx
import sqlalchemy as sa

from service.client.webhooks import HEADER, signature
from service.clock import ago, now
from service.core import Service
from service.db import Database
from service.db.schema import ENDED, FOUND, deliveries, jobs, notices, webhooks
from service.http.job_responses import view
from service.http.results import notice_of
from service.jobs.durable_jobs import job_of
from service.open_network import NOWHERE, resolve, there
from service.trust.webhook_secrets import secret_of

POLL_SECONDS = 2.0
LEASE_SECONDS = 60.0
AT_ONCE = 32
RETRY_SECONDS = (10, 60, 300, 1800, 7200, 21600, 43200)
"""From one try to the next; after the last a message is given up, 21 hours after the first."""

_log = logging.getLogger("mark3dgs.webhooks")


def deliver_for_ever(service: Service) -> NoReturn:
    """What a worker does in addition to its jobs."""
    asyncio.run(_deliver_all(service))


async def _deliver_all(service: Service) -> NoReturn:
    # Names that resolve slowly hold a thread each, also after their time is over.
    asyncio.get_running_loop().set_default_executor(ThreadPoolExecutor(2 * AT_ONCE, "webhook"))
    under_way: dict[str, asyncio.Task[None]] = {}
    while True:
        try:
            for row in await asyncio.to_thread(take, service.db, set(under_way), AT_ONCE - len(under_way)):
                under_way[row.webhook] = asyncio.create_task(_deliver(service, row))
                under_way[row.webhook].add_done_callback(partial(_done, under_way, row.webhook))
        except Exception as error:  # the database is away: pending messages wait there
            _log.warning("webhooks wait: %s", error)
        await asyncio.sleep(POLL_SECONDS)


def _done(under_way: dict[str, asyncio.Task[None]], webhook: str, task: asyncio.Task[None]) -> None:
    del under_way[webhook]
    if (error := task.exception()) is not None:  # it comes again when the lease is over
        _log.warning("webhook %s waits: %s", webhook, error)


def take(db: Database, busy: Collection[str] = (), most: int = AT_ONCE) -> list[Any]:
    """Deliveries that are due, at most one of each webhook and none of those that are `busy`; they are the caller's for
    the time of a lease."""
    nth = sa.func.row_number().over(partition_by=deliveries.c.webhook, order_by=deliveries.c.due_at).label("nth")
    due = sa.select(deliveries, nth).where(deliveries.c.due_at <= now(), deliveries.c.webhook.not_in(busy)).subquery()
    rows = db.query(sa.select(due).where(due.c.nth == 1).order_by(due.c.due_at).limit(most)).all()
    lease = _after(LEASE_SECONDS)
    return [row for row in rows if _set(db, row, row.tries, {"due_at": lease, "tries": row.tries + 1})]


async def _deliver(service: Service, row: Any) -> None:
    """Try one delivery, and record its outcome."""
    try:
        message = await asyncio.to_thread(_message, service, row)
        if message is None:
            await asyncio.to_thread(_drop, service.db, row)
            return
        url, body, headers = message
        status, outcome = await send(url, body, headers, private=service.settings.webhooks_private)
    except Exception:
        _log.exception("delivering to webhook %s failed", row.webhook)
        status, outcome = None, "a fault of this service"
    await asyncio.to_thread(_settle, service.db, row, status, outcome)


def _message(service: Service, row: Any) -> tuple[str, bytes, dict[str, str]] | None:
    """Address, body and headers; None where webhook, or job and notice, are gone."""
    with service.db.read() as connection:
        webhook = connection.execute(sa.select(webhooks).where(webhooks.c.id == row.webhook)).first()
        job = connection.execute(sa.select(jobs).where(jobs.c.id == row.job)).first()
        notice = connection.execute(sa.select(notices).where(notices.c.id == row.job)).first()
    if webhook is None:
        return None
    if job is not None:
        message = {"event": ENDED, "at": job.finished_at, "job": view(job_of(job)).model_dump()}
    elif notice is not None:
        message = {"event": FOUND, "at": notice.created_at, "notice": notice_of(notice).model_dump()}
    else:
        return None
    body = json.dumps(message, ensure_ascii=False).encode()
    signed = signature(secret_of(service.master, webhook), int(time.time()), body)
    agent = f"mark3dgs/{version('mark3dgs')}"
    return webhook.url, body, {"Content-Type": "application/json", "User-Agent": agent, HEADER: signed}


def _settle(db: Database, row: Any, status: int | None, outcome: str) -> None:
    """Record an attempt's outcome: done, given up, or due again."""
    last = row.tries >= len(RETRY_SECONDS)
    outcome_text = f"given up after {row.tries + 1} tries: {outcome}" if last and outcome != DELIVERED else outcome
    with db.write() as connection:
        said = {"last_at": now(), "last_status": status, "last_outcome": outcome_text}
        connection.execute(sa.update(webhooks).where(webhooks.c.id == row.webhook).values(said))
    if last or outcome == DELIVERED:
        _drop(db, row)
    else:
        _set(db, row, row.tries + 1, {"due_at": _after(RETRY_SECONDS[row.tries])})


def _drop(db: Database, row: Any) -> None:
    db.change(sa.delete(deliveries).where(_this(row)))


def _set(db: Database, row: Any, tries: int, values: Mapping[str, object]) -> bool:
    """Change a delivery of which so many tries were begun; False if another process has begun the next, or ended it."""
    with db.write() as connection:
        this = _this(row) & (deliveries.c.tries == tries)
        return connection.execute(sa.update(deliveries).where(this).values(values)).rowcount > 0


def _this(row: Any) -> sa.ColumnElement[bool]:
    return sa.and_(deliveries.c.webhook == row.webhook, deliveries.c.job == row.job)


def _after(seconds: float) -> str:
    return ago(-seconds / 3600)


SECONDS = 10.0
"""For all of it: resolving, connecting, sending, and the answer's headers."""

DELIVERED = "delivered"


async def send(url: str, body: bytes, headers: dict[str, str], *, private: bool = False) -> tuple[int | None, str]:
    """Post a message; status of the answer (None where there is none) and the outcome in words.

    `private`: to any address, and over plain HTTP.
    """
    try:
        async with asyncio.timeout(SECONDS):
            return await _post(httpx.URL(url), body, headers, private)
    except (TimeoutError, httpx.TimeoutException):
        return None, f"no answer within {SECONDS:.0f} s"
    except (httpx.HTTPError, httpx.InvalidURL, OSError, ValueError) as error:
        return None, f"no answer: {type(error).__name__}"


async def _post(url: httpx.URL, body: bytes, headers: dict[str, str], private: bool) -> tuple[int | None, str]:
    address = await resolve(url, private=private)
    if address is None or not (private or url.scheme == "https"):
        return None, NOWHERE
    target, of_name, extensions = there(url, address)
    async with (
        httpx.AsyncClient(trust_env=False, verify=httpx.create_ssl_context(), timeout=SECONDS) as client,
        client.stream("POST", target, content=body, headers=headers | of_name, extensions=extensions) as answer,
    ):
        return answer.status_code, DELIVERED if answer.is_success else f"answered {answer.status_code}"
