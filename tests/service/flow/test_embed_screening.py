"""Marks that an upload carries already: who is looked for, by which process, with whose keys, what is said of it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from engine.catalogue.entry import Entry
from engine.formats import read_model, write_model
from engine.registration.sketch import make_sketch
from engine.watermark.keys import OwnerKey
from service.core import Service
from service.db.schema import assets
from service.embeds import flow
from service.embeds.flow import PLAIN, choose, embed_flow
from service.jobs.port import Job, Run, State
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

    def __init__(self, folder: Path) -> None:
        self.service = Service.open(Settings(data_dir=folder / "data"))
        self.folder = folder
        self.key_ids = {
            name: store(self.service.db, self.service.master, name, OwnerKey(bytes.fromhex(secret))).id
            for name, secret in KEYS.items()
        }
        self.asked: list[tuple[str, str]] = []  # task, and its whole request as it goes through the pipe
        self.carries: list[str] = []

    def register(self, name: str, tenant: str, number: int) -> None:
        path = self.folder / "entry"
        path.write_bytes(Entry(make_sketch(clusters(number, 300)), None).to_bytes())
        row = dict.fromkeys(TEXTS.split(), name) | {"id": name, "tenant": tenant, "gaussians": 1}
        row |= {"owner_key": self.key_ids[tenant], "original_sha256": f"{number:064x}", "preview_sha256": ""}
        row |= {"sketch_sha256": self.service.blobs.put(path), "registered_at": name}
        record = self.folder / "record"
        record.write_text(name)
        row["record_sha256"] = self.service.blobs.put(record)
        with self.service.db.write() as connection:
            connection.execute(assets.insert().values(**row))
            commit_asset(connection, row, "", name)

    def embed(self, number: int, tenant: str = "bob") -> dict[str, Any]:
        """What the step comes to for a `.splat` of this model."""
        self.asked.clear()
        upload = self.folder / "upload.splat"
        write_model(clusters(number, 300), upload)
        names = ["cameras", "bits", "message", "psnr", "budget", "output", "format"]
        request = dict.fromkeys(names) | {"model": self.service.blobs.put(upload), "spz_frame": "auto"}
        request |= {"key_id": self.key_ids[tenant], "copy_name": "", "profile": "fast"}
        scratch = self.folder / "scratch"
        scratch.mkdir(exist_ok=True)
        job = Job("job_1", tenant, "key", "embed", State.RUNNING, request, created_at="2026-01-02T03:04:05")
        return dict(embed_flow(self.service)[0].do(Run(job, {}, scratch, self._work(scratch))))

    def _work(self, folder: Path) -> Any:
        def work(task: str, request: Mapping[str, Any]) -> dict[str, Any]:
            self.asked.append((task, json.dumps(request)))
            if task in ("screen", "index"):
                return TASKS[task](request, folder, silent)
            if task == "marks":
                names = [each["asset"] for each in request["candidates"]]
                return {"carries": [{"asset": name} for name in names if name in self.carries]}
            return {"report": {}}

        return work

    def tasks_with(self, tenant: str) -> list[str]:
        """Tasks that were handed this tenant's owner key."""
        return [task for task, request in self.asked if KEYS[tenant] in request]


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
    assert [task for task, _ in house.asked] == ["screen", "marks", "embed"]
    assert house.tasks_with("alice") == ["marks"]
    assert house.tasks_with("bob") == ["marks", "embed"]
    assert house.tasks_with("carol") == [], "what is not alike is not looked for"
    requests = dict(house.asked)
    upload = json.loads(requests["screen"])["model"]
    marks = json.loads(requests["marks"])
    assert json.loads(requests["embed"])["model"] == upload
    assert upload not in requests["marks"]
    plain = Path(marks["model"])
    assert plain.name == PLAIN
    assert read_model(plain).format == "ply"
    assert [each["asset"] for each in marks["candidates"]] == ["theirs", "mine"]
    assert made["screening"] == {"carries": [], "disputed": False, "not_screened": 0}


def test_where_nothing_is_alike_no_process_is_started_for_marks(house: House) -> None:
    house.register("theirs", "alice", 1)
    assert house.embed(7)["screening"] == {"carries": [], "disputed": False, "not_screened": 0}
    assert [task for task, _ in house.asked] == ["screen", "embed"]


def test_anothers_mark_ends_it_and_ones_own_is_told(house: House) -> None:
    house.register("theirs", "alice", 1)
    house.register("mine", "bob", 1)
    house.carries = ["mine"]
    made = house.embed(1)
    assert [each["asset"] for each in made["screening"]["carries"]] == ["mine"]
    assert not made["screening"]["disputed"]
    house.carries = ["mine", "theirs"]
    made = house.embed(1)
    assert made["screening"]["disputed"]
    assert made["kept"] == {}
    assert "embed" not in [task for task, _ in house.asked]


def row(name: str, tenant: str, original: str) -> Any:
    return SimpleNamespace(id=name, tenant=tenant, original_sha256=original)


def test_nobody_hides_a_copy_behind_many_of_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """The newest come first, one copy of each owner's originals in turn, and one's own last."""
    monkeypatch.setattr(flow, "SCREENED", 4)
    mallory = [row(f"m{number}", "mallory", "x") for number in range(9)]
    me = [row(f"b{number}", "bob", "z") for number in range(9)]
    alike = [*me, *mallory, row("a0", "alice", "y"), row("a1", "alice", "y")]
    assert {each.id for each in choose(alike, "bob")} == {"m0", "a0", "b0", "m1"}
    assert choose(alike[:3], "bob") == alike[:3]
    changed = [row(f"m{number}", "mallory", f"x{number}") for number in range(9)]
    assert {each.id for each in choose([*changed, *alike[-2:]], "bob")} == {"m0", "a0", "m1", "a1"}, "by many originals"
    two = [row("x0", "alice", "x"), row("x1", "alice", "x"), row("x2", "alice", "x"), row("x3", "alice", "x")]
    assert "y0" in {each.id for each in choose([*two, row("y0", "alice", "y")], "bob")}, "nor one's own other original"


def test_copies_of_one_original_stand_together() -> None:
    alike = [row("1", "alice", "x"), row("2", "carol", "y"), row("3", "carol", "x"), row("4", "alice", "y")]
    assert [each.id for each in choose(alike, "bob")] == ["1", "3", "2", "4"]


def test_what_was_not_looked_for_is_told(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flow, "SCREENED", 2)
    for number in range(5):
        house.register(f"copy {number}", "alice", 1)
    assert house.embed(1)["screening"]["not_screened"] == 3
