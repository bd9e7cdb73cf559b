"""The list of jobs: what waits, runs and has ended, after a reload, too; how long it takes; and a way out."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from tests.scenes import sparse_plant
from tests.service.web.conftest import Served, shoot
from tests.service.web.journey import LONG, embed, make_key
from tests.service.web.stock import ask, upload
from tests.service.web.stubs import a_job, an_asset, lists

if TYPE_CHECKING:
    from pathlib import Path

    from playwright.sync_api import Page


LIST = re.compile(r"/v1/jobs\?")


def test_jobs_survive_a_reload_and_can_be_cancelled(page: Page, served: Served, tmp_path: Path) -> None:
    file = tmp_path / "quince.splat"
    file.write_bytes(sparse_plant(every=20))
    make_key(page, "Jobs")
    embed(page, file, "Quince", "Acme")
    page.locator(".progress a[href='#jobs']").wait_for()  # it says where else the job is shown
    key = ask(served, "/v1/keys")["items"][0]["id"]
    body = {"upload_id": upload(served, file.name, file.read_bytes()), "key_id": key, "profile": "fast"}
    others = [ask(served, "/v1/embed", "POST", {**body, "copy_name": name})["id"] for name in ("one", "two")]
    page.get_by_role("navigation").get_by_role("link", name="Jobs").click()
    page.reload()
    page.get_by_role("heading", name="Jobs").wait_for()
    opened = page.locator("#jobs-open .job")
    opened.nth(1).wait_for()
    first = page.locator("[data-job]", has_text="Quince, copy for Acme")
    assert first.count() == 1, "its name is gone after the reload"

    last = page.locator(f"#jobs-open [data-job={others[-1]}]")
    assert "Queued" in last.inner_text()
    shoot(page, "jobs-open")
    last.get_by_role("button", name="Cancel").focus()
    page.keyboard.press("Enter")
    page.locator(f"#jobs-ended [data-job={others[-1]}]", has_text="Cancelled").wait_for()
    assert last.count() == 0
    assert page.evaluate("document.activeElement.id") == "jobs-title", "the focus went with the row"
    assert ask(served, f"/v1/jobs/{others[-1]}")["state"] == "cancelled"
    page.locator(f"#jobs-open [data-job={others[0]}]").get_by_role("button", name="Cancel").click()
    page.locator("#jobs-ended a", has_text="Quince, copy for Acme").wait_for(timeout=LONG)  # it keeps asking
    page.locator("#jobs-idle").wait_for()
    first.get_by_role("link").click()
    page.get_by_role("heading", name="Quince").wait_for()


def test_jobs_that_others_asked_for_tell_what_came_of_them(page: Page) -> None:
    found = {"claim_id": "cl_1", "asset_id": "as_1", "verdict": "not_marked"}
    made = {"asset_id": an_asset(5)["id"]}
    jobs = [a_job(1, kind="verify", state="succeeded", result=found), a_job(2, state="succeeded", result=made)]
    lists(page, jobs=jobs, claims=[], assets=[an_asset(6), an_asset(5, copy_name="Acme")])
    page.route("**/v1/claims/cl_1", lambda route: route.fulfill(json={"summary": {"headline": "Derived, or so"}}))
    page.get_by_role("link", name="Jobs").click()
    row = page.locator("#jobs-ended a[href='#claim/cl_1']", has_text="Derived, or so")
    row.wait_for()
    assert "took 1 min 0 s" in row.inner_text()
    page.locator(
        f"#jobs-ended a[href='#asset/{made['asset_id']}']", has_text="Mark · Model 5, copy for Acme"
    ).wait_for()


def test_turns_and_what_has_ended_meanwhile(page: Page) -> None:
    stage = {"stage": "record 3 of 20", "fraction": 0.12}
    running = a_job(140, kind="verify", state="running", name="found <b>here</b>.spz", **stage)  # started elsewhere
    queued = [a_job(150 + place, position=place, name="Quince", copy_name="Acme") for place in range(1, 121)]
    past = [a_job(number, state="cancelled") for number in range(45, 0, -1)]
    jobs: list[dict[str, Any]] = [*reversed(queued), *past, running]  # the oldest
    lists(page, jobs=jobs)
    page.route(f"**/v1/jobs/{running['id']}", lambda route: route.fulfill(json=running))
    page.get_by_role("link", name="Jobs").click()
    rows = page.locator("#jobs-open .job")
    rows.nth(120).wait_for()
    assert "Comparing the suspect with your records" in rows.nth(0).inner_text()
    assert "3 of 20" in rows.nth(0).inner_text()
    assert "found <b>here</b>.spz" in rows.nth(0).inner_text()
    assert "Mark · Quince, copy for Acme" in rows.nth(1).inner_text(), "whose copy it will be"
    assert rows.nth(0).locator("progress").evaluate("bar => bar.value") == 0.12
    assert [rows.nth(k).locator(".progress-now").inner_text() for k in (1, 2, 120)] == [
        "Queued: next", "Queued: 1 before it", "Queued: 119 before it",
    ]  # fmt: skip
    assert page.locator("#jobs-ended li").count() == 20
    page.get_by_role("button", name="Show older jobs").click()
    page.locator("#jobs-ended li").nth(39).wait_for()
    running |= {"state": "failed", "problem": {"title": "Too large", "detail": "it was too large", "status": 413}}
    page.locator(f"#jobs-ended li:first-child[data-job={running['id']}]").wait_for()
    assert "Too large: it was too large" in page.locator("#jobs-ended li").first.inner_text()
    assert page.locator("#jobs-ended li").count() == 41
    assert "Finished: Check" in page.locator("#said").inner_text(), "a screen reader announces it"


def test_a_list_out_of_reach_says_so_once_and_goes_on(page: Page) -> None:
    jobs = [a_job(1)]
    lists(page, jobs=jobs)
    page.get_by_role("link", name="Jobs").click()
    page.locator("#jobs-open .job").wait_for()
    page.route(LIST, lambda route: route.abort())
    page.get_by_role("alert").wait_for()
    jobs.append(a_job(0))
    page.unroute(LIST)
    page.locator("#jobs-open .job").nth(1).wait_for()
    assert page.get_by_role("alert").count() == 0


def test_a_job_that_could_not_be_cancelled_can_be_tried_again(page: Page) -> None:
    jobs = [a_job(1)]
    lists(page, jobs=jobs)
    page.route(f"**/v1/jobs/{jobs[0]['id']}", lambda route: route.abort(), times=1)
    page.get_by_role("link", name="Jobs").click()
    button = page.locator("#jobs-open").get_by_role("button", name="Cancel")
    button.click()
    page.get_by_role("alert").wait_for()
    assert page.locator("#jobs-open button[aria-disabled]").count() == 0
    with page.expect_request(lambda request: request.method == "DELETE"):
        button.click()


def test_the_list_is_left_alone_while_it_is_not_shown(page: Page) -> None:
    queries = lists(page, jobs=[a_job(1)])
    page.get_by_role("link", name="Jobs").click()
    page.locator("#jobs-open .job").wait_for()
    page.get_by_role("link", name="Check", exact=True).click()
    page.get_by_role("heading", name="Check a suspect").wait_for()
    before = len(queries)
    page.wait_for_timeout(3500)  # two looks and more
    assert len(queries) == before


WATCHED = """async (seen) => {
  const { Pace, leftWords } = await import("/static/js/pace.js");
  const pace = new Pace();
  const running = { state: "running", stage: "embed", fraction: 0 };
  return seen.map(([now, job]) => leftWords(pace.left({ ...running, ...job }, now)));
}"""


def test_time_left_is_said_where_it_follows_from_what_was_seen(page: Page) -> None:
    def said(*seen: tuple[float, dict[str, Any]]) -> list[str]:
        return list(page.evaluate(WATCHED, seen))

    def step(fraction: float, **more: Any) -> dict[str, Any]:
        return {"fraction": fraction, **more}

    # After 4 s a tenth is done: nine tenths take 36 s. Before that nothing is said, nor of what does not advance.
    assert said((0, step(0)), (2, step(0.1)), (4, step(0.1))) == ["", "", "about 40 s left of this step"]
    assert said((0, step(0.3)), (60, step(0.3)), (61, step(0.34))) == ["", "", ""]
    # What was done before anybody looked tells nothing of the pace; a stall makes it longer.
    assert said((0, step(0.8)), (10, step(0.9)), (40, step(0.9))) == [
        "", "less than 10 s left of this step", "about 40 s left of this step",
    ]  # fmt: skip
    # Another step begins anew, a record after a record does not; the whole job is not called a step.
    assert said((0, step(0)), (9, step(0.5)), (10, step(0.6, stage="refine")))[1:] == [
        "less than 10 s left of this step",
        "",
    ]
    assert (
        said((0, step(0, stage="record 1 of 9")), (60, step(0.1, stage="record 2 of 9")))[1]
        == "about 9 min left of this step"
    )
    assert said((0, step(0.9, fraction_total=0.1)), (30, step(0, fraction_total=0.4)))[1] == "about 60 s left"
    # Another attempt at it: what was seen of the first says nothing.
    assert said((0, step(0)), (9, step(0.5)), (12, step(0.1)), (14, step(0.2)))[1:] == [
        "less than 10 s left of this step",
        "",
        "",
    ]
    assert said((0, step(0.5, state="queued")), (9, step(0.9, state="queued"))) == ["", ""]
