"""The end of a job is delivered at least once, later where that fails, not for ever, and to no other tenant."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from service.client import check_webhook
from service.clock import ago, now
from service.core import Service
from service.db import Database
from service.db.schema import deliveries, jobs, webhooks
from service.embeds.watch import NO_TENANT, watch_flow
from service.jobs.durable_jobs import DurableJobs
from service.jobs.port import Job, Run, State
from service.settings import Settings
from service.trust import webhook_secrets as registry
from service.trust.master import MasterKey
from service.webhooks import delivery
from tests.service.rows import add_asset
from tests.service.webhooks.conftest import Receivers
from tests.service.webhooks.receiver import Receiver, answer

NUMBERS = count()
NO_ENGINE = "sqlite:////nowhere/jobs.sqlite"
"""Out of reach: rows of jobs, and no worker that runs them."""


def add(service: Service, receiver: Receiver, tenant: str = "acme") -> tuple[str, str]:
    """Id and secret of a webhook that goes to a receiver."""
    url = f"http://127.0.0.1:{receiver.port}/hook"
    secret, row = registry.add(service.db, service.master, tenant, url, "127.0.0.1", 5)
    return row.id, secret


def ended(service: Service, job_id: str, tenant: str = "acme") -> None:
    """A job that has come to something."""
    service.jobs.submit(Job(job_id, tenant, "key", "verify", State.QUEUED, {}))
    service.jobs.result(job_id, State.SUCCEEDED, {"claim_id": "cl_ö"})


def left(db: Database) -> dict[str, Any]:
    """What is still to be delivered, by job."""
    with db.read() as connection:
        return {row.job: row for row in connection.execute(sa.select(deliveries))}


def state(db: Database, name: str) -> Any:
    with db.read() as connection:
        return connection.execute(sa.select(webhooks).where(webhooks.c.id == name)).one()


def pass_time(db: Database) -> None:
    """Every delivery is due."""
    with db.write() as connection:
        connection.execute(sa.update(deliveries).values(due_at=ago(0)))


def deliver(service: Service) -> int:
    """Try what is due; how many that was."""

    async def one_round() -> int:
        rows = delivery.take(service.db)
        await asyncio.gather(*(delivery._deliver(service, row) for row in rows))
        return len(rows)

    return asyncio.run(one_round())


def test_the_end_of_a_job_is_told_signed(own: Service, receivers: Receivers) -> None:
    receiver, stranger, marks_alone = receivers(), receivers(), receivers()
    name, secret = add(own, receiver)
    _, other = add(own, stranger, "stranger")
    another, _ = add(own, marks_alone)
    own.db.change(sa.update(webhooks).where(webhooks.c.id == another).values(events="mark.found"))
    ended(own, "job_1")
    assert deliver(own) == 1
    ((path, headers, body),) = receiver.got
    event = check_webhook(secret, headers["mark3dgs-signature"], body)
    with pytest.raises(Exception, match="not signed"):
        check_webhook(other, headers["mark3dgs-signature"], body)
    job = own.jobs.get("acme", "job_1")
    assert job is not None
    assert (event.event, event.at, event.job.id, event.job.state) == (
        "job.ended",
        job.finished_at,
        "job_1",
        "succeeded",
    )
    assert (event.job.result, event.job.position, path) == ({"claim_id": "cl_ö"}, None, "/hook")
    assert headers["content-type"] == "application/json"
    assert set(json.loads(body)) == {"event", "at", "job"}
    assert secret.encode() not in body
    assert stranger.got == marks_alone.got == []
    assert (left(own.db), deliver(own)) == ({}, 0)
    row = state(own.db, name)
    assert (row.last_status, row.last_outcome) == (204, "delivered")
    assert row.last_at <= now()


def test_a_mark_that_was_found_is_told_to_those_who_asked_for_it(own: Service, receivers: Receivers) -> None:
    receiver, jobs_alone = receivers(), receivers()
    _, secret = add(own, receiver)
    name, _ = add(own, jobs_alone)
    own.db.change(sa.update(webhooks).where(webhooks.c.id == name).values(events="job.ended"))
    add_asset(own.db, tenant="acme")
    found = {"asset": "as_1", "z": 99.0, "log10_false_claim": -2000.0, "copy_z": None, "copy_named": None}
    job = Job("watch_as_2", NO_TENANT, "", "watch", State.RUNNING, {"asset": "as_2"})
    for _ in range(2):
        watch_flow(own)[1].do(Run(job, {"watch": {"carries": [found]}}))
    assert deliver(own) == 1
    ((_, headers, body),) = receiver.got
    event = check_webhook(secret, headers["mark3dgs-signature"], body)
    assert (event.event, event.job) == ("mark.found", None)
    assert event.notice is not None
    assert (event.notice.asset_id, event.notice.uploaded_as, event.at) == ("as_1", "as_2", event.notice.created_at)
    assert jobs_alone.got == []


@pytest.fixture(params=["sqlite", "postgres"])
def db(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    url = ""
    if request.param == "postgres":
        url = request.getfixturevalue("postgres").new_database(f"hooks{next(NUMBERS)}")
    settings = Settings(data_dir=tmp_path, database_url=url)
    made = Database(settings.database())
    made.migrate()
    for tenant in ("acme", "acme", "stranger"):
        registry.add(made, MasterKey(bytes(range(32))), tenant, "https://hooks.test/", "hooks.test", 5)
    yield made
    made.close()


def test_every_end_is_told_once_to_each_of_the_tenants_own(db: Database) -> None:
    rows = DurableJobs(db, NO_ENGINE)
    for job_id in ("done", "failed", "cancelled", "stopped", "open"):
        rows.submit(Job(job_id, "acme", "key", "verify", State.QUEUED, {}))
    rows.begin("stopped", "w")
    assert rows.cancel("acme", "stopped").state == State.RUNNING  # type: ignore[union-attr]
    assert left(db) == {}
    rows.result("done", State.SUCCEEDED, {})
    rows.result("failed", State.FAILED, {"status": 422})
    for _ in range(2):
        rows.cancel("acme", "cancelled")
        rows.result("stopped", State.CANCELLED, {})
        rows.result("done", State.FAILED, {})
    with db.read() as connection:
        output = connection.execute(
            sa.select(deliveries.c.job, webhooks.c.tenant).join(webhooks, webhooks.c.id == deliveries.c.webhook)
        )
        found = sorted(map(tuple, output))
    assert found == sorted(2 * [(job, "acme") for job in ("done", "failed", "cancelled", "stopped")])


def test_an_end_that_cannot_be_noted_is_none(db: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both are in one transaction: no job ends without its message."""
    rows = DurableJobs(db, NO_ENGINE)
    rows.submit(Job("a", "acme", "key", "verify", State.QUEUED, {}))

    def die(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("service.jobs.durable_jobs.announce", die)
    with pytest.raises(KeyboardInterrupt):
        rows.result("a", State.SUCCEEDED, {})
    with pytest.raises(KeyboardInterrupt):
        rows.cancel("acme", "a")
    assert rows.get("acme", "a").state == State.QUEUED  # type: ignore[union-attr]


def test_what_is_taken_is_nobody_elses_until_its_lease_ends(db: Database) -> None:
    rows = DurableJobs(db, NO_ENGINE)
    for number in range(3):
        rows.submit(Job(f"j{number}", "acme", "key", "verify", State.QUEUED, {}))
        rows.result(f"j{number}", State.SUCCEEDED, {})
    first = delivery.take(db)
    assert len(first) == len({row.webhook for row in first}) == 2, "one of each webhook"
    assert {row.job for row in first} == {"j0"}, "the oldest"
    busy = [row.webhook for row in first]
    assert delivery.take(db, busy) == []
    second = delivery.take(db, busy[:1])
    assert [(row.webhook, row.job) for row in second] == [(busy[1], "j1")]
    assert len(delivery.take(db, most=1)) == 1
    assert not {("j0", busy[0])} & {(row.job, row.webhook) for row in delivery.take(db)}
    pass_time(db)  # the worker that took them has died
    again = delivery.take(db)
    assert {(row.webhook, row.job) for row in again} <= {(each, f"j{n}") for each in busy for n in range(3)}
    assert len(again) == 2
    assert all(row.tries >= 1 for row in again if row.job == "j0")


def test_two_who_take_at_a_time(db: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both have read the same row; one of them has it."""
    rows = DurableJobs(db, NO_ENGINE)
    rows.submit(Job("a", "stranger", "key", "verify", State.QUEUED, {}))
    rows.result("a", State.SUCCEEDED, {})
    real, got = delivery._set, []

    def slow(*given: Any) -> bool:
        monkeypatch.setattr(delivery, "_set", real)
        got.append(delivery.take(db))
        return real(*given)

    monkeypatch.setattr(delivery, "_set", slow)
    got.append(delivery.take(db))
    assert [len(each) for each in got] == [1, 0]


def test_what_fails_comes_again_later_and_later_and_then_no_more(own: Service, receivers: Receivers) -> None:
    receiver = receivers(answer(500))
    name, secret = add(own, receiver)
    ended(own, "job_1")
    pauses = []
    for number in range(1, 8):
        assert deliver(own) == 1
        row = left(own.db)["job_1"]
        assert row.tries == number
        assert (state(own.db, name).last_status, state(own.db, name).last_outcome) == (500, "answered 500")
        pauses.append(next(pause for pause in delivery.RETRY_SECONDS if row.due_at <= ago(-pause / 3600)))
        assert deliver(own) == 0, "not before its time"
        pass_time(own.db)
    assert tuple(pauses) == delivery.RETRY_SECONDS
    assert 20 < sum(pauses) / 3600 < 22
    assert deliver(own) == 1
    assert left(own.db) == {}
    assert state(own.db, name).last_outcome == "given up after 8 tries: answered 500"
    signed = {headers["mark3dgs-signature"] for _, headers, _ in receiver.got}
    assert len(receiver.got) == 8
    assert len({body for _, _, body in receiver.got}) == 1, "the message stays the same"
    assert all(check_webhook(secret, each, receiver.got[0][2]) for each in signed), "each try says when it was sent"


def test_one_that_recovers(own: Service, receivers: Receivers) -> None:
    receiver = receivers(answer(503))
    name, _ = add(own, receiver)
    ended(own, "job_1")
    deliver(own)
    receiver.behave = answer(200)
    pass_time(own.db)
    deliver(own)
    assert (left(own.db), state(own.db, name).last_outcome) == ({}, "delivered")


def test_one_that_nobody_answers(own: Service) -> None:
    _, row = registry.add(own.db, own.master, "acme", "http://127.0.0.1:1/", "127.0.0.1", 5)
    ended(own, "job_1")
    deliver(own)
    assert (state(own.db, row.id).last_status, state(own.db, row.id).last_outcome) == (None, "no answer: ConnectError")
    assert left(own.db)["job_1"].tries == 1


def test_the_operator_decides_whether_it_may_go_to_this_machine(own: Service, receivers: Receivers) -> None:
    receiver = receivers()
    name, _ = add(own, receiver)
    own.settings.webhooks_private = False
    ended(own, "job_1")
    deliver(own)
    assert (receiver.got, state(own.db, name).last_status) == ([], None)
    assert "not public" in state(own.db, name).last_outcome


def test_what_is_gone_is_not_told(own: Service, receivers: Receivers) -> None:
    receiver = receivers()
    name, _ = add(own, receiver)
    for job_id in ("pruned", "late"):
        ended(own, job_id)
    with own.db.write() as connection:
        connection.execute(sa.delete(jobs).where(jobs.c.id == "pruned"))
    assert deliver(own) == 1
    assert set(left(own.db)) == {"late"}
    taken = delivery.take(own.db)
    registry.delete(own.db, "acme", name)
    assert left(own.db) == {}
    asyncio.run(delivery._deliver(own, taken[0]))
    assert (receiver.got, left(own.db)) == ([], {})


def test_a_late_word_changes_nothing(own: Service, receivers: Receivers) -> None:
    """A process that was thought dead comes back after another has begun the next try."""
    add(own, receivers())
    ended(own, "job_1")
    (slow,) = delivery.take(own.db)
    pass_time(own.db)
    (fast,) = delivery.take(own.db)
    lease = left(own.db)["job_1"].due_at
    delivery._settle(own.db, slow, 500, "answered 500")
    assert (left(own.db)["job_1"].due_at, left(own.db)["job_1"].tries, fast.tries) == (lease, 2, 1)


def test_a_fault_of_ours_is_tried_again_and_not_for_ever(own: Service, receivers: Receivers) -> None:
    receiver = receivers()
    name, _ = add(own, receiver)
    ended(own, "job_1")
    with own.db.write() as connection:
        connection.execute(sa.update(webhooks).values(sealed=b"altered"))
    assert deliver(own) == 1
    assert (left(own.db)["job_1"].tries, state(own.db, name).last_outcome) == (1, "a fault of this service")
    for _ in delivery.RETRY_SECONDS:
        pass_time(own.db)
        assert deliver(own) == 1
    assert (left(own.db), receiver.got) == ({}, [])
