"""Marks that an upload carries already: who is looked for, by which process, with whose keys, what is said of it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import sqlalchemy as sa

from engine.catalogue.entry import Entry
from engine.formats import read_model, write_model
from engine.registration.sketch import make_sketch
from engine.watermark.keys import OwnerKey
from service.core import Service
from service.db.schema import assets, audit, notices
from service.embeds import screening
from service.embeds.flow import embed_flow
from service.embeds.screening import PLAIN, choose
from service.embeds.watch import NO_TENANT, watch_flow
from service.http.job_responses import view
from service.http.results import notice_of
from service.jobs.port import Flow, Job, Run, State
from service.problems import Problem
from service.settings import Settings
from service.trust.commitments import commit_asset
from service.trust.owner_keys import store
from service.work.tasks import TASKS
from tests.registration.registration_cases import scene as clusters
from tests.service.work.conftest import silent

KEYS = {name: digit * 62 + "00" for name, digit in (("alice", "a"), ("bob", "b"), ("carol", "c"))}
TEXTS = "job label copy record_id message profile report model_sha256 original_format model_format"


class House:
    """Three tenants, whose assets are of a few hundred Gaussians; their marks are found as `carries` says."""

    def __init__(self, folder: Path, subject_embeds_per_day: int = 3) -> None:
        self.service = Service.open(Settings(data_dir=folder / "data", subject_embeds_per_day=subject_embeds_per_day))
        self.folder = folder
        self.key_ids = {
            name: store(self.service.db, self.service.master, name, OwnerKey(bytes.fromhex(secret))).id
            for name, secret in KEYS.items()
        }
        self.calls: list[tuple[str, str]] = []  # task, and its whole request as it goes through the pipe
        self.carries: list[str] = []
        self.copy_z: dict[str, float] = {}

    def register(self, name: str, tenant: str, number: int, gaussians: int = 300) -> None:
        path = self.folder / "entry"
        model = clusters(number, 300).take(np.arange(gaussians))
        path.write_bytes(Entry(make_sketch(model), None).to_bytes())
        row = dict.fromkeys(TEXTS.split(), name) | {"id": name, "tenant": tenant, "gaussians": 1}
        row |= {"owner_key": self.key_ids[tenant], "preview_sha256": ""}
        row |= {"original_sha256": f"{300 * number + gaussians:064x}"}
        row |= {"sketch_sha256": self.service.blobs.put(path), "registered_at": name}
        record = self.folder / "record"
        record.write_text(name)
        row["record_sha256"] = self.service.blobs.put(record)
        with self.service.db.write() as connection:
            connection.execute(assets.insert().values(**row))
            commit_asset(connection, row, "", name)

    def embed(self, number: int, tenant: str = "bob") -> dict[str, Any]:
        """What the step comes to for a `.splat` of this model."""
        self.calls.clear()
        upload = self.folder / "upload.splat"
        write_model(clusters(number, 300), upload)
        return self.ask(self.service.blobs.put(upload), tenant).results["embed"]

    def ask(self, model: str, tenant: str = "bob", name: str = "job_1") -> Run:
        """An embed job's whole way."""
        names = ["cameras", "bits", "message", "psnr", "budget", "output", "format"]
        request = dict.fromkeys(names) | {"model": model, "spz_frame": "auto", "label": "", "names": ["upload.splat"]}
        request |= {"key_id": self.key_ids[tenant], "copy_name": "", "profile": "fast"}
        job = Job(name, tenant, "key", "embed", State.RUNNING, request, created_at="2026-01-02T03:04:05")
        return self.do(embed_flow(self.service), job)

    def watch(self) -> list[dict[str, Any]]:
        """What comes of the jobs that look for others' marks; notices of all tenants."""
        for job in self.service.jobs.list(NO_TENANT, 100, states=[State.QUEUED]):
            self.do(watch_flow(self.service), job)
            self.service.jobs.result(job.id, State.SUCCEEDED, {})
        rows = self.service.db.query(notices.select()).all()
        return [notice_of(row).model_dump() | {"tenant": row.tenant} for row in rows]

    def do(self, flow: Flow, job: Job) -> Run:
        scratch = self.folder / "scratch"
        scratch.mkdir(exist_ok=True)
        run = Run(job, {}, scratch, self._work(scratch))
        for step in flow:
            run = replace(run, results={**run.results, step.name: step.do(run)})
        return run

    def _work(self, folder: Path) -> Any:
        def work(task: str, request: Mapping[str, Any]) -> dict[str, Any]:
            self.calls.append((task, json.dumps(request)))
            if task in ("screen", "index"):
                return TASKS[task](request, folder, silent)
            if task == "marks":
                names = [each["asset"] for each in request["candidates"]]
                found = {"z": 99.0, "log10_false_claim": -2000.0, "copy_named": True}
                output = [found | {"asset": name, "copy_z": self.copy_z.get(name, 1.0)} for name in names]
                return {"carries": [each for each in output if each["asset"] in self.carries]}
            files = {name: name for name in ("model", "record", "preview", "sketch")}
            for name in files:
                (folder / name).write_text(name)
            report = {"gaussians_out": 300, "psnr_worst_view": 47.0, "ssim_worst_view": 0.9985, "seconds": 1.0}
            made = dict.fromkeys(("message", "original_format", "format"), "x") | {"record_id": "0" * 32}
            return {"report": report, "files": files, **made}

        return work

    def tasks_with(self, tenant: str) -> list[str]:
        """Tasks that were handed this tenant's owner key."""
        return [task for task, request in self.calls if KEYS[tenant] in request]


@pytest.fixture
def house(tmp_path: Path) -> Iterator[House]:
    made = House(tmp_path)
    yield made
    made.service.close()


def test_no_key_but_the_one_that_marks_enters_a_process_that_reads_the_upload(house: House) -> None:
    house.register("theirs", "alice", 1)
    house.register("mine", "bob", 1)
    house.register("strange", "carol", 2)
    made = house.embed(1)
    assert [task for task, _ in house.calls] == ["screen", "marks", "embed"]
    assert house.tasks_with("bob") == ["marks", "embed"]
    assert house.tasks_with("alice") == house.tasks_with("carol") == []
    requests = dict(house.calls)
    upload = json.loads(requests["screen"])["model"]
    marks = json.loads(requests["marks"])
    assert json.loads(requests["embed"])["model"] == upload
    assert upload not in requests["marks"]
    plain = Path(marks["model"])
    assert plain.name == PLAIN
    assert read_model(plain).format == "ply"
    assert [each["asset"] for each in marks["candidates"]] == ["mine"]
    assert made["screening"] == {"carries": [], "not_screened": 0}
    house.calls.clear()
    house.watch()
    assert [task for task, _ in house.calls] == ["screen", "marks"]
    assert house.tasks_with("alice") == ["marks"]
    assert house.tasks_with("bob") == house.tasks_with("carol") == [], "what is not alike is not looked for"
    assert upload not in dict(house.calls)["marks"]


def test_where_nothing_is_alike_no_process_is_started_for_marks(house: House) -> None:
    house.register("mine", "bob", 1)
    assert house.embed(7)["screening"] == {"carries": [], "not_screened": 0}
    assert [task for task, _ in house.calls] == ["screen", "embed"]


def test_ones_own_mark_is_told_and_anothers_to_its_owner(house: House) -> None:
    house.register("theirs", "alice", 1)
    house.register("mine", "bob", 1)
    house.carries = ["mine", "theirs"]
    made = house.embed(1)
    assert [each["asset"] for each in made["screening"]["carries"]] == ["mine"]
    assert made["kept"]["model"], "it is marked all the same"
    (notice,) = house.watch()
    assert (notice["tenant"], notice["asset_id"], notice["uploaded_as"]) == ("alice", "theirs", "as_1")
    assert notice["strength"] == pytest.approx(6643.9, abs=0.1)
    assert len(house.watch()) == 1, "once"


def test_of_many_copies_of_one_original_its_owner_gets_one_notice(house: House) -> None:
    for number in range(3):
        house.register(f"copy {number}", "alice", 1)
    house.carries, house.copy_z = ["copy 0", "copy 1", "copy 2"], {"copy 1": 40.0}
    house.embed(1)
    output = [(notice["tenant"], notice["asset_id"]) for notice in house.watch()]
    assert output == [("alice", "copy 1")], "about the copy with the strongest evidence"


def test_forty_questions_tell_an_uploader_nothing(tmp_path: Path) -> None:
    """Slight changes of one model, where each carries another's mark, and where none does: answers, lists, work and log
    are the same, one by one; the owner is notified of each."""
    seen = {}
    for carries in (True, False):
        (folder := tmp_path / str(carries)).mkdir()
        house = House(folder, subject_embeds_per_day=100)
        house.register("theirs", "alice", 1)
        house.carries = ["theirs"] if carries else []
        seen[carries] = [_question(house, number) for number in range(40)]
        assert len(house.watch()) == 40 * carries
        house.service.close()
    assert seen[True] == seen[False]


def test_when_it_is_looked_at_is_drawn(tmp_path: Path) -> None:
    """A job that always came right after would keep the uploader's next one waiting for as long as it takes."""
    house = House(tmp_path, subject_embeds_per_day=100)
    for number in range(20):
        _question(house, number, look=False)
    waits = [
        (datetime.fromisoformat(job.created_at) - datetime.now(UTC)).total_seconds() / 60
        for job in house.service.jobs.list(NO_TENANT, 100)
    ]
    house.service.close()
    assert 30 < max(waits) <= house.service.settings.watch_minutes
    assert -1 < min(waits) < 30


def _question(house: House, number: int, *, look: bool = True) -> tuple[str, list[str], list[Any], int]:
    """What an uploader sees of one: the job, what was done for it, all assets, and how long the log is by then."""
    model = clusters(1, 300)
    model = replace(model, opacity_logits=model.opacity_logits + np.float32(1e-3 * number))
    upload = house.folder / "upload.ply"
    write_model(model, upload)
    house.calls.clear()
    run = house.ask(house.service.blobs.put(upload), name=f"job_{number:02}")
    tasks = [task for task, _ in house.calls]
    assert all("theirs" not in request for _, request in house.calls), "nothing that the answer could follow from"
    if look:
        house.watch()
    ending = run.results["commit"]
    shown = view(replace(run.job, state=ending["state"], result=ending["result"])).model_dump_json()
    columns = [column for column in assets.c if column.name not in ("registered_at", "owner_key")]
    mine = house.service.db.query(sa.select(*columns).where(assets.c.tenant == "bob").order_by(assets.c.id)).all()
    return shown, tasks, list(mine), _entries(house)


def _entries(house: House) -> int:
    return int(house.service.db.query(sa.select(sa.func.count()).select_from(audit)).scalar_one())


def test_uploads_that_are_alike_share_a_budget(house: House) -> None:
    """Slight changes of one model are how a mark is tried out; copies of one file ask nothing new."""
    house.register("mine", "bob", 1)
    house.register("theirs", "alice", 2)
    for _ in range(3):
        house.embed(2)  # the tenant has none that is alike
    for _ in range(house.service.settings.subject_embeds_per_day):
        house.embed(1)
    with pytest.raises(Problem, match="at most 3 in 24 h") as caught:
        house.embed(1)
    assert caught.value.kind == "budget-exceeded"
    house.embed(2)


def test_a_newer_likeness_is_no_new_budget(house: House) -> None:
    """Each upload becomes an asset, which the next one resembles most."""
    house.register("a", "bob", 1, gaussians=250)
    for _ in range(house.service.settings.subject_embeds_per_day):
        house.embed(1)
    house.register("b", "bob", 1)
    with pytest.raises(Problem, match="at most 3 in 24 h"):
        house.embed(1)


def row(name: str, tenant: str, original: str) -> Any:
    return SimpleNamespace(id=name, tenant=tenant, original_sha256=original)


def test_nobody_hides_a_copy_behind_many_of_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """The newest come first, one copy of each owner's originals in turn."""
    monkeypatch.setattr(screening, "SCREENED", 4)
    mallory = [row(f"m{number}", "mallory", "x") for number in range(9)]
    alike = [*mallory, row("a0", "alice", "y"), row("a1", "alice", "y")]
    assert {each.id for each in choose(alike)} == {"m0", "a0", "m1", "a1"}
    assert choose(alike[:3]) == alike[:3]
    changed = [row(f"m{number}", "mallory", f"x{number}") for number in range(9)]
    assert {each.id for each in choose([*changed, *alike[-2:]])} == {"m0", "a0", "m1", "a1"}, "by many originals"
    two = [row("x0", "alice", "x"), row("x1", "alice", "x"), row("x2", "alice", "x"), row("x3", "alice", "x")]
    assert "y0" in {each.id for each in choose([*two, row("y0", "alice", "y")])}, "nor one's own other original"


def test_copies_of_one_original_stand_together() -> None:
    alike = [row("1", "alice", "x"), row("2", "carol", "y"), row("3", "carol", "x"), row("4", "alice", "y")]
    assert [each.id for each in choose(alike)] == ["1", "3", "2", "4"]


def test_what_was_not_looked_for_is_told(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(screening, "SCREENED", 2)
    for number in range(5):
        house.register(f"copy {number}", "bob", 1)
    assert house.embed(1)["screening"]["not_screened"] == 3
