"""Jobs over HTTP: 202 and where to look, retries, waiting, ETags, events, cancelling, budgets."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from service.core import Service
from service.jobs.port import State
from service.settings import Settings
from tests.service.api.conftest import SMALL, Api, _api


def embed_body(api: Api) -> dict[str, object]:
    return {"upload_id": api.upload(SMALL.read_bytes()), "key_id": api.key(), "profile": "fast", "bits": 16}


def test_202_and_where_to_look(api: Api) -> None:
    answer = api.client.post("/v1/embed", json=embed_body(api) | {"copy_name": "Acme"})
    job = answer.json()
    assert (answer.status_code, job["copy_name"]) == (202, "Acme")
    assert answer.headers["location"] == f"/v1/jobs/{job['id']}"
    assert int(answer.headers["retry-after"]) >= 1
    assert job["state"] == "queued"
    assert job["problem"] is None


def test_a_form_does_the_same(api: Api) -> None:
    form = {"key_id": api.key(), "bits": "16", "label": ""}
    answer = api.client.post("/v1/embed", data=form, files={"model": ("a/../m.ply", SMALL.read_bytes())})
    assert answer.status_code == 202, answer.text


def test_retries(api: Api) -> None:
    """Same key and body: same job. Another body: 422. A key is free again where its request was refused."""
    body, headers = embed_body(api), {"Idempotency-Key": "one"}
    refused = api.client.post("/v1/embed", json=body | {"key_id": "nothing"}, headers=headers)
    assert refused.status_code == 404
    first = api.client.post("/v1/embed", json=body, headers=headers)
    again = api.client.post("/v1/embed", json=body, headers=headers)
    assert first.json()["id"] == again.json()["id"]
    other = api.client.post("/v1/embed", json=body | {"label": "another"}, headers=headers)
    assert (other.status_code, other.json()["type"]) == (422, "urn:mark3dgs:problem:idempotency-mismatch")
    fresh = api.client.post("/v1/embed", json=body)
    assert fresh.json()["id"] != first.json()["id"]


def test_a_retry_while_the_first_is_being_answered(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    body, headers = embed_body(api), {"Idempotency-Key": "two"}
    answers = []

    def submit(job: object, most: int) -> object:
        answers.append(api.client.post("/v1/embed", json=body, headers=headers))
        raise RuntimeError("the first dies here")

    monkeypatch.setattr(api.service.jobs, "submit", submit)
    assert api.client.post("/v1/embed", json=body, headers=headers).status_code == 500
    assert (answers[0].status_code, answers[0].json()["type"]) == (409, "urn:mark3dgs:problem:request-in-flight")


def test_two_keys_may_draw_one_idempotency_key(service: Service) -> None:
    """Neither is handed the other's job, nor its problem."""
    one, other = _api(service, "tenant of two", ["embed", "verify"]), _api(service, "tenant of two", ["verify"])
    headers, jobs = {"Idempotency-Key": "same"}, []
    for api in (one, other, one, other):
        body = {"upload_id": api.upload(SMALL.read_bytes())}
        jobs.append(api.client.post("/v1/verify", json=body, headers=headers).json()["id"])
    assert jobs[:2] == jobs[2:]
    assert jobs[0] != jobs[1]


def test_waiting_and_etags(api: Api) -> None:
    answer = api.client.post("/v1/embed", json=embed_body(api), headers={"Prefer": "respond-async, wait=1"})
    assert (answer.status_code, answer.headers["preference-applied"]) == (202, "wait=1")
    path = answer.headers["location"]
    etag = api.client.get(path).headers["etag"]
    assert api.client.get(path, headers={"If-None-Match": etag}).status_code == 304
    api.service.jobs.begin(answer.json()["id"], "a worker")
    api.service.jobs.progress(answer.json()["id"], "look", 0.5)
    moved = api.client.get(path, headers={"If-None-Match": etag})
    assert moved.status_code == 200
    assert (moved.json()["stage"], moved.json()["fraction"]) == ("look", 0.5)


def test_the_problem_of_a_job_is_the_answer_to_who_waits(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    submit = api.service.jobs.submit

    def submit_and_fail(job: object, most: int) -> object:
        made = submit(job)  # type: ignore[arg-type]
        plain = {"type": "urn:mark3dgs:problem:capacity", "title": "t", "status": 422, "detail": "too small"}
        api.service.jobs.result(made.id, State.FAILED, {**plain, "capacity": 8})
        return made

    monkeypatch.setattr(api.service.jobs, "submit", submit_and_fail)
    answer = api.client.post("/v1/embed", json=embed_body(api), headers={"Prefer": "wait=5"})
    assert (answer.status_code, answer.json()["capacity"]) == (422, 8)
    job = answer.json()["job"]
    assert api.client.get(f"/v1/jobs/{job}").json()["problem"]["detail"] == "too small"


def test_events(api: Api) -> None:
    job = api.client.post("/v1/embed", json=embed_body(api)).json()["id"]
    api.client.delete(f"/v1/jobs/{job}")
    with api.client.stream("GET", f"/v1/jobs/{job}/events") as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        lines = [line for line in stream.iter_lines() if line.startswith("data:")]
    assert json.loads(lines[-1].removeprefix("data:"))["state"] == "cancelled"


def test_cancelling(api: Api) -> None:
    job = api.client.post("/v1/embed", json=embed_body(api)).json()["id"]
    first = api.client.delete(f"/v1/jobs/{job}")
    assert first.status_code == 202
    assert first.json()["state"] == "cancelled"
    assert api.client.delete(f"/v1/jobs/{job}").json()["finished_at"] == first.json()["finished_at"]


def test_what_has_ended_is_beyond_cancelling(api: Api) -> None:
    job = api.client.post("/v1/embed", json=embed_body(api)).json()["id"]
    api.service.jobs.begin(job, "a worker")
    api.service.jobs.result(job, State.SUCCEEDED, {})
    answer = api.client.delete(f"/v1/jobs/{job}")
    assert (answer.status_code, answer.json()["type"]) == (409, "urn:mark3dgs:problem:conflict")
    assert "succeeded" in answer.json()["detail"]
    assert api.client.get(f"/v1/jobs/{job}").json()["state"] == "succeeded"


def test_pages(api: Api) -> None:
    body = embed_body(api)
    made = [api.client.post("/v1/embed", json=body).json()["id"] for _ in range(5)]
    seen, after = [], ""
    while True:
        page = api.client.get("/v1/jobs", params={"limit": 2, "after": after}).json()
        seen += [job["id"] for job in page["items"]]
        after = page["next"]
        if after is None:
            break
    assert seen == made[::-1]


@pytest.mark.parametrize(("kind", "budget"), [("embed", "embeds_per_hour"), ("verify", "verifies_per_hour")])
def test_budgets(api: Api, monkeypatch: pytest.MonkeyPatch, kind: str, budget: str) -> None:
    small = Settings(**{**api.service.settings.model_dump(), budget: 2, "master_key": None})
    monkeypatch.setattr(api.client.app.state, "service", type(api.service)(**{**vars(api.service), "settings": small}))  # type: ignore[attr-defined]
    body = embed_body(api)
    body = body if kind == "embed" else {"upload_id": body["upload_id"]}
    codes = [api.client.post(f"/v1/{kind}", json=body).status_code for _ in range(3)]
    refused = api.client.post(f"/v1/{kind}", json=body)
    assert codes == [202, 202, 429]
    assert int(refused.headers["retry-after"]) > 0


@pytest.mark.parametrize(
    ("path", "body", "status", "part"),
    [
        ("/v1/embed", {"upload_id": "x", "key_id": "y", "psnr": 5}, 422, "psnr"),
        ("/v1/embed", {"upload_id": "x", "key_id": "y", "message": "abc"}, 422, "message"),
        ("/v1/embed", {"upload_id": "x", "key_id": "y", "bits": 17}, 422, "bits"),
        ("/v1/embed", {"upload_id": "x", "key_id": "y", "bits": 32, "message": "c0ffee42"}, 422, "not both"),
        ("/v1/embed", {"upload_id": "x", "key_id": "y", "colour": 1}, 422, "colour"),
        ("/v1/embed", {"key_id": "y"}, 422, "upload_id"),
        ("/v1/embed", {}, 422, "upload_id"),
        ("/v1/embed", {"upload_id": "x", "key_id": "y"}, 404, "'x'"),
        ("/v1/verify", {}, 422, "one suspect"),
        ("/v1/verify", {"upload_id": "x", "image_upload_ids": ["y"]}, 422, "one suspect"),
        ("/v1/verify", {"upload_id": "x", "cameras_upload_id": "y"}, 422, "cameras"),
        ("/v1/verify", {"upload_id": "x", "false_claim_rate": 0.999}, 422, "less than or equal to 0.000001"),
        ("/v1/verify", {"upload_id": "x", "false_claim_rate": 1.1e-6}, 422, "less than or equal to 0.000001"),
        ("/v1/verify", {"upload_id": "x", "suspect_seen": "yesterday"}, 422, "suspect_seen"),
        ("/v1/keys", {"key": "00" * 32}, 422, "repeated"),
    ],
)
def test_refusals_name_the_value(api: Api, path: str, body: dict[str, object], status: int, part: str) -> None:
    answer = api.client.post(path, json=body)
    assert answer.status_code == status, answer.text
    problem = answer.json()
    assert part in json.dumps(problem)
    assert problem["request_id"] == answer.headers["x-request-id"]


def test_bodies_that_are_no_json(api: Api) -> None:
    for path in ("/v1/embed", "/v1/keys"):
        answer = api.client.post(path, content=b"{", headers={"Content-Type": "application/json"})
        assert answer.status_code == 400, answer.text
    for route, hint in (("embed", "curl -F model=@FILE"), ("uploads", "Content-Type: application/json")):
        said = api.client.post(f"/v1/{route}", content=b"{}", headers={"Content-Type": "text/plain"})
        assert said.status_code in (400, 415)
        assert hint in said.json()["detail"]
    broken = api.client.post("/v1/embed", content=b"x", headers={"Content-Type": "multipart/form-data"})
    assert broken.status_code == 400


def test_the_key_is_shown_once_and_never_listed(api: Api) -> None:
    made = api.client.post("/v1/keys", json={"label": "mine", "reveal": True}).json()
    secret = made["key"].splitlines()[-1]
    assert secret not in api.client.get("/v1/keys").text
    assert all(secret.encode() not in path.read_bytes() for path in _files(api.service.settings.data_dir))
    again = api.client.post("/v1/keys", json={"key": secret})
    assert again.status_code == 409
    assert api.client.delete(f"/v1/keys/{made['id']}").status_code == 204
    assert api.client.post("/v1/keys", json={"key": secret}).json()["id"] == made["id"]


def _files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


def test_without_a_key_the_tenants_only_one_is_taken(api: Api) -> None:
    body: dict[str, object] = {"upload_id": api.upload(SMALL.read_bytes())}
    for _ in range(2):
        assert api.client.post("/v1/embed", json=body).status_code == 202
    assert len(api.client.get("/v1/keys").json()["items"]) == 1
    api.key()
    assert "several" in api.client.post("/v1/embed", json=body).json()["detail"]
