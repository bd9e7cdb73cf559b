"""Tenants take turns: a long queue of one delays no other, and a cancelled job costs no turn."""

from __future__ import annotations

from typing import Any

import pytest

from service.clock import ago, now
from service.jobs.durable_jobs import DurableJobs
from service.jobs.port import FINAL, Job, State
from tests.service.jobs.conftest import Workshop


def submit(shop: Workshop, tenant: str, *job_ids: str) -> None:
    request: dict[str, Any] = {"marks": str(shop.marks), "gate": str(shop.gate)}
    for job_id in job_ids:
        shop.jobs.submit(Job(job_id, tenant, "key", "three", State.QUEUED, request))


def begun(shop: Workshop) -> list[str]:
    """Jobs in the order in which they were begun."""
    return [line.split()[0] for line in shop.marks.read_text().splitlines() if line.endswith("first")]


def in_line(jobs: DurableJobs) -> set[str]:
    """Jobs that a worker could take now."""
    return {each.workflow_id for each in jobs.client().list_workflows(status="ENQUEUED")}


@pytest.fixture
def shop(workshop: Workshop) -> Workshop:
    workshop.gate.touch()
    return workshop


def test_a_long_queue_of_one_keeps_nobody_waiting(shop: Workshop) -> None:
    shop.gate.unlink()
    many, few = [f"many{number}" for number in range(8)], ["few0", "few1"]
    submit(shop, "many", *many)
    shop.start("w1")
    shop.wait(lambda: begun(shop) == ["many0"])
    submit(shop, "few", *few)
    submit(shop, "third", "third0")
    listed = [job for tenant in ("many", "few", "third") for job in shop.jobs.list(tenant)]
    places = shop.jobs.positions(listed)
    shop.gate.touch()
    shop.wait(lambda: len(begun(shop)) == 11)
    order = begun(shop)
    assert order[1:3] == ["few0", "third0"], "who has none at work comes before who has"
    assert order.index("few1") <= 4, "then they take turns"
    assert [job for job in order if job in many] == many, "a tenant's own jobs keep their order"
    assert places == {job: place for place, job in enumerate(order[1:], 1)}, "what was predicted comes true"


def test_the_tenant_with_the_fewest_at_work_comes_first(jobs: DurableJobs) -> None:
    """Two at work for one tenant, none for the other, as the queue itself orders them."""
    for job_id in ("a0", "a1", "a2"):
        jobs.submit(Job(job_id, "a", "key", "three", State.QUEUED, {}))
        if job_id != "a2":
            jobs.begin(job_id, "w")
    jobs.submit(Job("b0", "b", "key", "three", State.QUEUED, {}))
    priority = {each.workflow_id: each.priority for each in jobs.client().list_workflows(status="ENQUEUED")}
    assert priority["b0"] < priority["a1"] < priority["a2"]


def test_places_in_the_queue(jobs: DurableJobs) -> None:
    made = {}
    for second, job_id in enumerate(("a0", "a1", "a2", "b0", "b1", "c0")):
        made[job_id] = jobs.submit(
            Job(job_id, job_id[0], "key", "three", State.QUEUED, {}, created_at=f"2026-01-01T00:00:0{second}")
        )
    everything = list(made.values())
    assert jobs.positions(everything) == {"a0": 1, "b0": 2, "c0": 3, "a1": 4, "b1": 5, "a2": 6}
    jobs.begin("a0", "w")
    jobs.cancel("b", "b0")
    everything = [job for tenant in "abc" for job in jobs.list(tenant)]
    assert jobs.positions(everything) == {"b1": 1, "c0": 2, "a1": 3, "a2": 4}, "who has one at work comes later"
    assert jobs.positions([job for job in everything if job.id == "a2"]) == {"a2": 4}, "others' jobs count"


def test_what_is_not_due_waits_and_keeps_nobody_waiting(shop: Workshop) -> None:
    """None begins before it is due, whatever was submitted first; until then it has no place before others."""
    request = {"marks": str(shop.marks), "gate": str(shop.gate)}
    for job_id, seconds in (("never", 3600.0), ("second", 4.0), ("first", 2.0), ("third", 4.5)):
        shop.jobs.submit(Job(job_id, "own", "", "three", State.QUEUED, request, created_at=ago(-seconds / 3600)))
    submit(shop, "t", "now", "after")
    assert shop.jobs.positions(shop.jobs.list("t")) == {"now": 1, "after": 2}
    shop.start("w1")
    shop.wait(lambda: len(begun(shop)) == 5, 120)
    waits, *begun_jobs = shop.jobs.list("own")
    assert (waits.id, waits.state) == ("never", State.QUEUED)
    assert {job.id for job in begun_jobs} == {"first", "second", "third"}
    assert all(job.started_at >= job.created_at for job in begun_jobs)
    assert now() < waits.created_at


def test_what_was_cancelled_costs_no_turn(jobs: DurableJobs) -> None:
    names = [f"j{number:02}" for number in range(40)]
    for name in names:
        jobs.submit(Job(name, "t", "key", "three", State.QUEUED, {}, created_at=f"2026-01-01T00:00:{name[1:]}"))
    assert in_line(jobs) == {"j00"}, "of a tenant one job stands in the queue"
    for name in names[:-1]:
        job = jobs.cancel("t", name)
        assert job is not None
        assert job.state in FINAL
        assert len(in_line(jobs)) == 1
    assert in_line(jobs) == {"j39"}


def test_a_next_job_that_was_never_enqueued_is_found(shop: Workshop, monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that dies between the row and the queue leaves a tenant's turn to `reconcile`."""
    monkeypatch.setattr(shop.jobs, "_advance", lambda tenant: None)
    submit(shop, "t", "lost0", "lost1")
    assert in_line(shop.jobs) == set()
    shop.start("w1")
    shop.wait(lambda: begun(shop) == ["lost0", "lost1"])
