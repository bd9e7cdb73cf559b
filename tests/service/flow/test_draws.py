"""A service with a time-stamping service: each asset is drawn for once, and claims rest on the stamp."""

from __future__ import annotations

import base64
import json
import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest

from engine.errors import InputError
from engine.flows.embed.config import CONFIG
from engine.flows.records.opened_record import open_record
from engine.watermark.keys import OwnerKey
from engine.watermark.rates import DRAWS
from service.claims.document import of_what_was_found
from service.claims.issuing import issue_claim
from service.claims.offline import Status, verify_report
from service.core import Service
from service.db.schema import assets, draws
from service.embeds.flow import embed_flow
from service.jobs.port import Job, Run, State
from service.problems import Problem
from service.settings import Settings
from service.trust import signing
from service.trust.commitments import registration_of
from service.trust.draws import draws_for, stamp_to_draw
from service.trust.owner_keys import store
from service.verifications.flow import verify_flow
from service.work.tasks import TASKS
from tests.records.test_timestamps import Authority, serving
from tests.scenes import sparse_plant
from tests.service.claims.cases import verify_job
from tests.service.flow.commands import client_of, mark3dgs
from tests.service.serving import start

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the time stamps")

KEY = OwnerKey(bytes(range(32)))
QUESTION = b"mark3dgs draw\0".hex() + "5e" * 64


@dataclass
class Told:
    """Who runs a task, in this process."""

    answer: Callable[[str], str] | None
    calls: list[str] = field(default_factory=list)

    def __call__(self, stage: str, fraction: float) -> None:
        pass

    def ask(self, question: str) -> str:
        assert self.answer is not None
        self.calls.append(question)
        return self.answer(question)


class House:
    """A service whose tasks run here; `stamps` counts requests to the time-stamping service."""

    def __init__(self, folder: Path, url: str, certificates: Path | str) -> None:
        settings = Settings(data_dir=folder / "data", tsa_url=url, tsa_certificates=str(certificates))
        self.service = Service.open(settings)
        self.folder = folder
        signing.ensure_key(self.service.db, self.service.master)
        self.key_id = store(self.service.db, self.service.master, "acme", KEY).id
        upload = folder / "plant.splat"
        upload.write_bytes(sparse_plant())
        self.model = self.service.blobs.put(upload)
        self.jobs = 0

    def embed(self, copy: str = "a") -> Any:
        """The row of a new asset."""
        names = ["cameras", "bits", "message", "psnr", "budget", "output", "format"]
        request = dict.fromkeys(names) | {"model": self.model, "spz_frame": "auto", "key_id": self.key_id}
        return self._row(self._run(embed_flow, request | {"copy_name": copy, "profile": "fast", "label": ""}))

    def verify(self, row: Any, **request: Any) -> dict[str, Any]:
        """The reply of the task about an asset's own model."""
        calls = {"model": row.model_sha256, "images": [], "cameras": None, "spz_frame": "auto", "asset_id": row.id}
        calls |= {"false_claim_rate": 1e-9, "route": "model", "names": []}
        return dict(verify_flow(self.service)[0].do(self._begun(calls | request)))

    def document(self, found: dict[str, Any]) -> tuple[dict[str, Any], str]:
        """The signed claim of a reply."""
        with self.service.db.write() as connection:
            job = verify_job(f"job_claim{self.jobs}", suspect=self.model)
            claim = issue_claim(connection, self.service.master, job, of_what_was_found(found))
        return claim.document, claim.jws

    def _row(self, job: str) -> Any:
        with self.service.db.read() as connection:
            return connection.execute(assets.select().where(assets.c.job == job)).one()

    def _run(self, flow: Callable[[Service], Any], request: Mapping[str, Any]) -> str:
        run = self._begun(request)
        steps = flow(self.service)
        made = steps[0].do(run)
        steps[1].do(Run(run.job, {"embed": made}, run.folder, run.work))
        return run.job.id

    def _begun(self, request: Mapping[str, Any]) -> Run:
        self.jobs += 1
        folder = self.folder / f"scratch{self.jobs}"
        folder.mkdir()
        job = Job(
            f"job_{self.jobs}", "acme", "key", "embed", State.RUNNING, request, created_at="2026-01-02T03:04:05.000000"
        )

        def work(task: str, request: Mapping[str, Any], answer: Callable[[str], str] | None = None) -> Any:
            return TASKS[task](request, folder, Told(answer))

        return Run(job, {}, folder, work)


@dataclass
class Stamps:
    """A time-stamping service on loopback."""

    authority: Authority
    url: str = ""
    given: int = 0

    def reply(self, query: bytes) -> bytes:
        self.given += 1
        return self.authority.reply(query)

    @property
    def certificates(self) -> Path:
        return self.authority.folder / "ca.pem"


@pytest.fixture(scope="module")
def stamps(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stamps]:
    made = Stamps(Authority(tmp_path_factory.mktemp("authority")))
    with serving(made.reply) as url:
        made.url = url
        yield made


@pytest.fixture
def house(tmp_path: Path, stamps: Stamps) -> Iterator[House]:
    made = House(tmp_path, stamps.url, stamps.certificates)
    yield made
    made.service.close()


@pytest.mark.long
@pytest.mark.slow
def test_copies_are_drawn_for_once_and_claim_at_chance_rate(house: House, stamps: Stamps) -> None:
    before, rows = stamps.given, [house.embed("a")]
    calls = stamps.given
    assert before < calls <= before + CONFIG.strength.draws, "one for each plan"
    rows.append(house.embed("b"))
    assert stamps.given == calls
    opened = [open_record(house.service.blobs.read(row.record_sha256), KEY) for row in rows]
    assert opened[0].grain_key == opened[1].grain_key
    assert opened[0].commitments == opened[1].commitments
    assert opened[0].draw is not None
    with house.service.db.read() as connection:
        logged = registration_of(connection, rows[0].id).payload["drawn_sha256"]
    assert logged == sha256(opened[0].commitments["drawn"].encode()).hexdigest()
    found = house.verify(rows[1])
    assert (found["claim"]["rate_basis"], found["claim"]["false_claim_rate"]) == ("drawn", 1e-9)
    assert found["tries"] % DRAWS == 0
    document, jws = house.document(found)
    assert base64.b64decode(document["drawing"]["token"]) == opened[1].draw.token
    keys = signing.jwks(house.service.db)
    checked = verify_report(jws.encode(), keys, stamps.authority.roots)
    assert checked.valid, checked.checks
    assert {check.code: check.status for check in checked.checks}["drawing"] is Status.PASS
    # An operator who removes its certificates, or names others, has no time stamp that drew.
    house.service.settings.tsa_certificates = ""
    weaker = house.verify(rows[1])
    assert (weaker["claim"]["rate_basis"], weaker["claim"]["false_claim_rate"]) == ("undated", 2.0**-128)
    assert weaker["drawing"] is None
    assert verify_report(house.document(weaker)[1].encode(), keys).valid


@pytest.mark.long
@pytest.mark.slow
def test_without_a_time_stamping_service_claims_need_the_strict_rate(tmp_path: Path, stamps: Stamps) -> None:
    """Also later, when there is one: copies that are out cannot be drawn for again."""
    house = House(tmp_path, stamps.url, "")
    assert not draws_for(house.service.settings)
    first, before = house.embed("a"), stamps.given
    house.service.settings.tsa_certificates = str(stamps.certificates)
    later = house.embed("b")
    assert stamps.given == before
    opened = [open_record(house.service.blobs.read(row.record_sha256), KEY) for row in (first, later)]
    assert opened[0].grain_key == opened[1].grain_key
    for row in (first, later):
        found = house.verify(row)
        assert (found["claim"]["verdict"], found["claim"]["rate_basis"]) == ("marked", "undated")
        assert found["claim"]["false_claim_rate"] == 2.0**-128
    house.service.close()


@pytest.mark.slow
def test_the_record_proves_it_without_the_service(tmp_path: Path, stamps: Stamps) -> None:
    """Through the processes of a service: a task asks, the worker answers; the command line checks the stamp."""
    given = {"TSA_URL": stamps.url, "TSA_CERTIFICATES": str(stamps.certificates)}
    served = start(tmp_path, lean=True, **given)
    try:
        client = client_of(served, "alice")
        key = client.call("POST", "/v1/keys", json={"reveal": True})
        made = client.embed(sparse_plant(every=15), profile="fast", key_id=key["id"], bits=16, copy_name="acme")
        (tmp_path / "owner.key").write_text(key["key"])
        (tmp_path / "owner.key").chmod(0o600)
        client.record(made.asset_id, tmp_path / "scene.record")
        model = client.download(made.asset_id, tmp_path / "marked.ply", format="ply")
        files = "--record", str(tmp_path / "scene.record"), "--key", str(tmp_path / "owner.key")
        trust = "--tsa-certificates", str(stamps.certificates)
        for more, basis, rate in ((trust, "drawn", 1e-9), ((), "self_declared", 2.0**-128)):
            done = mark3dgs(served, "verify", str(model), *files, *more, "--json")
            assert done.returncode == 0, done.stdout + done.stderr
            output = json.loads(done.stdout)
            assert (output["rate_basis"], output["false_claim_rate"]) == (basis, rate)
        assert "no certificate was given" in output["notes"][-1]
        found = client.verify(model)
        client.jws(found.claim_id, tmp_path / "claim.jws")
        (tmp_path / "jwks.json").write_text(json.dumps(client.call("GET", "/.well-known/jwks.json")))
        report = "verify-report", str(tmp_path / "claim.jws"), "--jwks", str(tmp_path / "jwks.json"), *trust
        done = mark3dgs(served, *report)
        assert done.returncode == 0, done.stdout + done.stderr
        assert "Test stamps" in done.stdout
    finally:
        served.stop()


def test_a_stamp_is_asked_for_once_and_must_hold(house: House, stamps: Stamps) -> None:
    service, before = house.service, stamps.given
    first = stamp_to_draw(service.db, service.settings, QUESTION)
    assert stamp_to_draw(service.db, service.settings, QUESTION) == first
    assert stamps.given == before + 1
    assert stamp_to_draw(service.db, service.settings, QUESTION + "00") != first
    service.settings.tsa_url = "http://127.0.0.1:1/"
    assert stamp_to_draw(service.db, service.settings, QUESTION) == first
    with pytest.raises(Problem, match="try again later") as caught:
        stamp_to_draw(service.db, service.settings, QUESTION + "01")
    assert caught.value.kind == "no-time-stamp"


def test_a_stamp_by_who_is_not_vouched_for_is_not_taken(house: House, tmp_path: Path) -> None:
    folder = tmp_path / "other"
    folder.mkdir()
    other = Authority(folder)
    house.service.settings.tsa_certificates = str(folder / "ca.pem")
    with pytest.raises(Problem, match="does not hold"):
        stamp_to_draw(house.service.db, house.service.settings, QUESTION)
    assert house.service.db.query(draws.select()).all() == []
    assert other.roots


def test_what_another_job_was_given_meanwhile_is_taken(house: House, stamps: Stamps) -> None:
    """Two copies at once have one owner's layer."""
    service, given = house.service, stamps.authority.reply
    inner: list[str] = []

    def slow(query: bytes) -> bytes:
        if not inner:  # while the first waits for its answer, a second job asks and is done
            inner.append("")
            inner[0] = stamp_to_draw(service.db, service.settings.model_copy(update={"tsa_url": stamps.url}), QUESTION)
        return given(query)

    with serving(slow) as url:
        outer = stamp_to_draw(service.db, service.settings.model_copy(update={"tsa_url": url}), QUESTION)
    assert outer == inner[0]


def test_certificates_that_are_none_are_named(tmp_path: Path) -> None:
    for name in (tmp_path / "gone.pem", Path(__file__)):
        with pytest.raises(InputError, match="MARK3DGS_TSA_CERTIFICATES"):
            draws_for(Settings(tsa_url="http://tsa", tsa_certificates=str(name)))
