"""The index of all assets in the data folder: kept, grown, learnt anew, lost; what it lacks hides no asset."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from engine.catalogue.entry import Entry
from engine.formats import write_model
from engine.model import GaussianModel
from engine.registration.sketch import make_sketch
from service import asset_screening
from service.asset_screening import screen
from service.core import Service
from service.db.schema import assets
from service.jobs.port import Job, Run, State
from service.settings import Settings
from service.work.tasks import TASKS
from tests.registration.registration_cases import scene as clusters
from tests.service.work.conftest import silent

TEXTS = "job owner_key label copy record_id message profile report model_sha256 original_format model_format"


class Shop:
    """A service with assets of a hundred Gaussians, whose tasks run here."""

    def __init__(self, folder: Path) -> None:
        self.service = Service.open(Settings(data_dir=folder / "data"))
        self.folder = folder
        self.calls: list[tuple[str, Mapping[str, Any]]] = []

    def register(self, number: int, copies: int = 1, tenant: str = "alice") -> None:
        """An asset, and so many copies of it."""
        path = self.folder / "entry"
        path.write_bytes(Entry(make_sketch(model(number)), None).to_bytes())
        entry = self.service.blobs.put(path)
        for copy in range(copies):
            name = f"{number}.{copy}"
            texts = dict.fromkeys(TEXTS.split(), name)
            digests = {"original_sha256": f"{number:064x}", "record_sha256": "", "preview_sha256": ""}
            row = {"id": name, "tenant": tenant, "gaussians": 1, "sketch_sha256": entry, "registered_at": name}
            with self.service.db.write() as connection:
                connection.execute(assets.insert().values(**texts, **digests, **row))

    def rows(self) -> list[Any]:
        with self.service.db.read() as connection:
            return list(connection.execute(assets.select()))

    def screen(self, suspect: int, **options: bool) -> list[str]:
        """Ids of the assets that a model of this number may come from."""
        self.calls.clear()
        write_model(model(suspect), self.folder / "suspect.ply")
        folder = self.folder / "scratch"
        folder.mkdir(exist_ok=True)
        run = Run(Job("job", "alice", "key", "verify", State.RUNNING, {}), {}, folder, self._work(folder))
        calls = {"model": str(self.folder / "suspect.ply"), "images": []}
        found = [row.id for row in screen(self.service, run, calls, self.rows(), **options)]
        shutil.rmtree(folder)
        return found

    def _work(self, folder: Path) -> Any:
        def work(task: str, request: Mapping[str, Any]) -> dict[str, Any]:
            self.calls.append((task, request))
            return TASKS[task](request, folder, silent)

        return work

    @property
    def missing(self) -> int:
        """Entries that the last screening had to read itself."""
        return len(self.calls[-1][1]["entries"])

    @property
    def kept(self) -> list[Path]:
        return list((self.folder / "data" / "catalogue").glob("index-*"))


def model(number: int) -> GaussianModel:
    return clusters(number, 300)


@pytest.fixture
def shop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Shop]:
    monkeypatch.setattr(asset_screening, "MOST_MISSING", 2)
    made = Shop(tmp_path)
    yield made
    made.service.close()


def test_copies_are_one_asset_and_all_come_along(shop: Shop) -> None:
    shop.register(1, copies=5)
    shop.register(2)
    assert sorted(shop.screen(1)) == [f"1.{copy}" for copy in range(5)]
    assert shop.screen(2) == ["2.0"]
    assert shop.screen(9) == []
    assert len(shop.screen(9, likely=True)) in (1, 5)
    assert [task for task, _ in shop.calls] == ["screen"]
    assert shop.missing == 2


def test_the_index_is_kept_grows_and_can_be_lost(shop: Shop) -> None:
    for number in range(3):
        shop.register(number)
    assert shop.screen(2) == ["2.0"]
    assert [task for task, _ in shop.calls] == ["index", "screen"]
    assert shop.missing == 0
    first = shop.kept
    shop.register(3)
    assert shop.screen(3) == ["3.0"]
    assert (shop.kept, shop.missing) == (first, 1)
    for number in (4, 5):
        shop.register(number)
    assert shop.screen(4) == ["4.0"]
    assert shop.missing == 0
    assert len(shop.kept) == 1
    assert shop.kept != first
    assert len(shop.calls[0][1]["entries"]) == 3, "what was there is kept"
    (shop.kept[0] / "assets.json").write_text("{")
    assert shop.screen(1) == ["1.0"]
    assert len(shop.calls[0][1]["entries"]) == 6, "a damaged index is made anew"


def test_an_index_is_learnt_anew_when_outgrown(shop: Shop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(asset_screening, "OUTGROWN", 2)
    for number in range(3):
        shop.register(number)
    shop.screen(0)
    for number in range(3, 6):
        shop.register(number)
    assert shop.screen(5) == ["5.0"]
    assert len(shop.calls[0][1]["entries"]) == 6
    assert shop.kept[0].name.startswith("index-6-")


def test_a_damaged_or_lost_entry_hides_nobody_and_is_not_ruled_out(shop: Shop) -> None:
    for number in range(2):
        shop.register(number)
    rows = {row.id: row for row in shop.rows()}
    blob = shop.service.blobs.local(rows["0.0"].sketch_sha256, shop.folder)
    for damage in (lambda: blob.write_bytes(b"nonsense"), blob.unlink):
        damage()
        assert shop.screen(1) == ["1.0", "0.0"]
        assert shop.screen(7) == ["0.0"]


def test_nothing_registered_is_nothing_asked(shop: Shop) -> None:
    assert shop.screen(1) == []
    assert shop.calls == []


def test_a_lost_record_is_named_by_whoever_opens_it(shop: Shop) -> None:
    assert shop.service.local_or_gone("ab" * 32, Run(Job("j", "t", "k", "embed", State.RUNNING, {}))) == ""
