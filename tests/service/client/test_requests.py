"""Requests of the client: what is sent again and when, what errors carry, and how a job is followed."""

from __future__ import annotations

import time
from datetime import UTC, datetime, timedelta
from email.utils import format_datetime
from typing import Any

import httpx
import pytest

from service.client import ServiceError
from tests.service.client.driving import do, job, problem


@pytest.fixture(autouse=True)
def pauses(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Seconds that the client paused, none of which pass."""
    found: list[float] = []

    monkeypatch.setattr(time, "sleep", found.append)
    return found


class Played:
    """A service that gives these answers, one after another, the last for ever; an exception is no answer."""

    def __init__(self, *answers: httpx.Response | Exception) -> None:
        self.answers, self.calls = list(answers), list[httpx.Request]()

    def __call__(self, request: httpx.Request) -> httpx.Response:
        self.calls.append(request)
        answer = self.answers[min(len(self.calls), len(self.answers)) - 1]
        if isinstance(answer, Exception):
            raise answer
        return httpx.Response(answer.status_code, headers=answer.headers, content=answer.content)


def refused(status: int, retry_after: str = "") -> httpx.Response:
    answer = problem("unavailable" if status == 503 else "budget-exceeded", status)
    if retry_after:
        answer.headers["Retry-After"] = retry_after
    return answer


def test_what_is_refused_for_now_is_sent_again(pauses: list[float]) -> None:
    played = Played(refused(503, "3"), refused(429), refused(429), httpx.Response(200, json={"keys": []}))
    assert do(played, "call", "GET", "/v1/keys") == {"keys": []}
    assert [request.headers["authorization"] for request in played.calls] == ["Bearer mk_a_b"] * 4
    assert pauses[0] == 3.0
    assert 0.5 <= pauses[1] <= 1.0
    assert 1.0 <= pauses[2] <= 2.0


def test_a_date_of_retry_after_is_honoured(pauses: list[float]) -> None:
    when = format_datetime(datetime.now(UTC) + timedelta(seconds=30), usegmt=True)
    do(Played(refused(503, when), httpx.Response(204)), "call", "DELETE", "/v1/keys/k")
    assert 25 < pauses[0] <= 30


@pytest.mark.parametrize("status", [400, 401, 403, 404, 409, 413, 422, 500, 502, 504, 507])
def test_no_other_status_is(status: int, pauses: list[float]) -> None:
    answer = problem("conflict", status)
    answer.headers["Retry-After"] = "1"
    played = Played(answer)
    with pytest.raises(ServiceError) as caught:
        do(played, "call", "POST", "/v1/keys", json={})
    assert (caught.value.status, len(played.calls), pauses) == (status, 1, [])


def test_patience_ends(pauses: list[float]) -> None:
    with pytest.raises(ServiceError, match="budget-exceeded") as caught:
        do(Played(refused(429, "3600")), "call", "GET", "/v1/keys")
    assert (caught.value.retry_after, pauses) == (3600, [])
    played = Played(refused(503))
    with pytest.raises(ServiceError, match="unavailable"):
        do(played, "call", "GET", "/v1/keys", patience=20.0)
    assert 10 < sum(pauses) <= 20
    assert len(played.calls) == len(pauses) + 1


def test_an_error_carries_the_problem() -> None:
    errors = [{"place": "body.bits", "text": "must be 16 or more, got 7"}]
    with pytest.raises(ServiceError) as caught:
        do(Played(problem("invalid-request", 422, errors=errors)), "call", "POST", "/v1/embed", json={})
    error = caught.value
    assert (error.code, error.status, error.detail, error.request_id) == ("invalid-request", 422, "the value 7", "r1")
    assert error.values == {"errors": errors}
    assert str(error) == "invalid-request: the value 7"


@pytest.mark.parametrize(
    "answer",
    [
        httpx.Response(502, html="<h1>Bad Gateway</h1>"),
        httpx.Response(400, json=["no problem"]),
        httpx.Response(302, headers={"Location": "http://elsewhere.test/"}),
        httpx.Response(200, text="<html>"),
        httpx.Response(200, json={"id": "as_1"}),
        httpx.Response(200, json=[]),
    ],
)
def test_answers_of_something_else(answer: httpx.Response) -> None:
    """A proxy, or another service, at this address."""
    played = Played(answer)
    with pytest.raises(ServiceError) as caught:
        do(played, "asset", "as_1")
    assert caught.value.code == "unexpected-answer"
    assert len(played.calls) == 1


def test_no_answer(pauses: list[float]) -> None:
    """Sent again only where that is harmless: a look at a job is, a new key is not."""
    played = Played(httpx.ConnectError("refused"))
    with pytest.raises(ServiceError, match="unreachable: ConnectError"):
        do(played, "call", "POST", "/v1/keys", json={})
    assert (len(played.calls), pauses) == (1, [])
    again = Played(httpx.ReadError("gone"), httpx.Response(200, json=job("succeeded", result={})))
    assert do(again, "wait", "job_1").ended


def test_a_job_is_asked_for_once() -> None:
    """A lost answer does not make two jobs: the same key goes with both tries."""
    slot = {"id": "up_1", "name": "", "size": 3, "offset": 3, "state": "complete", "sha256": None}
    slot |= {"info": {"kind": "picture"}}
    keys = []

    def service(request: httpx.Request) -> httpx.Response:
        if request.url.path == "/v1/uploads":
            return httpx.Response(200, json={"items": []} if request.method == "GET" else slot)
        keys.append((request.headers["idempotency-key"], request.content))
        if len(keys) == 1:
            raise httpx.ReadError("lost")
        return httpx.Response(202, json=job("queued", kind="verify"))

    assert do(service, "submit_verify", b"png", asset_id="as_1").id == "job_1"
    assert len(keys) == 2
    assert len(set(keys)) == 1
    assert keys[0][1] == b'{"image_upload_ids":["up_1"],"asset_id":"as_1"}'


def test_a_job_is_followed_to_its_end(pauses: list[float]) -> None:
    same = httpx.Response(304)
    states = [job("queued", stage="", fraction=0.0), job("running"), job("failed")]
    first, second, last = (
        httpx.Response(200, json=plain, headers={"ETag": f'"{i}"'}) for i, plain in enumerate(states)
    )
    played, seen = Played(first, same, same, second, last), list[tuple[str, float]]()
    ended = do(played, "wait", "job_1", progress=lambda *output: seen.append(output))
    assert (ended.state, seen) == ("failed", [("", 0.0), ("look", 0.5), ("look", 0.5)])
    assert [request.headers.get("if-none-match") for request in played.calls] == [None, '"0"', '"0"', '"0"', '"1"']
    assert pauses == [0.1, 0.2, 0.4, 0.1]


def test_waiting_ends() -> None:
    with pytest.raises(ServiceError, match="timed-out") as caught:
        do(Played(httpx.Response(200, json=job("running"))), "wait", "job_1", timeout=0.0)
    assert caught.value.values == {"job": "job_1"}


FAILED = {"type": "urn:mark3dgs:problem:capacity", "title": "T", "status": 422, "detail": "too small", "wanted": 256}


@pytest.mark.parametrize(
    ("members", "code", "values"),
    [
        ({"state": "failed", "problem": FAILED}, "capacity", {"wanted": 256, "job": "job_1"}),
        ({"state": "disputed", "result": {"text": "another's"}}, "disputed", {"job": "job_1"}),
        ({"state": "cancelled"}, "cancelled", {"job": "job_1"}),
        ({"state": "failed", "problem": {"odd": 1}}, "unexpected-answer", {"job": "job_1"}),
        ({"state": "running"}, "timed-out", {"job": "job_1"}),
    ],
)
def test_what_came_to_nothing(members: dict[str, Any], code: str, values: dict[str, Any]) -> None:
    found = do(Played(httpx.Response(200, json=job(**members))), "job", "job_1")
    with pytest.raises(ServiceError) as caught:
        found.outcome()
    assert (caught.value.code, caught.value.values) == (code, values)


def test_an_id_is_one_part_of_an_address() -> None:
    played = Played(problem("not-found", 404))
    with pytest.raises(ServiceError):
        do(played, "claim", "cl_1/../../keys?x=1")
    assert played.calls[0].url.raw_path == b"/v1/claims/cl_1%2F..%2F..%2Fkeys%3Fx%3D1"


def test_lists_go_on_to_their_end() -> None:
    summary = {"asset_id": None, "verdict": "marked", "headline": "", "finding": "", "log10_false_claim": -9.0}
    pages = {"": (["cl_3", "cl_2"], "cl_2"), "cl_2": (["cl_1"], None)}

    def service(request: httpx.Request) -> httpx.Response:
        names, following = pages[request.url.params["after"]]
        items = [{"id": name, "created_at": "", **summary, "new_member": 1} for name in names]
        return httpx.Response(200, json={"items": items, "next": following})

    assert [claim.id for claim in do(service, "claims")] == ["cl_3", "cl_2", "cl_1"]


def test_an_empty_object_is_a_body() -> None:
    played = Played(httpx.Response(201, json={"id": "key_1"}))
    assert do(played, "call", "POST", "/v1/keys", json={}) == {"id": "key_1"}
    assert played.calls[0].content == b"{}"
    assert played.calls[0].headers["content-type"] == "application/json"
