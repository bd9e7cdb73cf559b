"""The index of a service: which assets a suspect may come from, found without a key."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.catalogue.entry import Entry
from engine.lab.evaluate.strangers import make_stranger
from engine.registration.sketch import make_sketch
from service.work.tasks import TASKS
from tests.service.work.conftest import FOREIGN, Marked, shot_of, silent


@pytest.fixture(scope="module")
def entries(marked: Marked, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Of the marked plant, two strangers (the second has no landmarks), and of two that cannot be read."""
    folder = tmp_path_factory.mktemp("entries")
    own = Entry.from_bytes(marked.path("sketch").read_bytes())
    assert own.seen is not None
    mixed = np.random.default_rng(0).permutation(own.seen.descriptors.reshape(-1)).reshape(-1, 128)
    foreign = type(own.seen)(mixed, own.seen.views, own.seen.places)
    (folder / "one").write_bytes(Entry(make_sketch(make_stranger(0)), foreign).to_bytes())
    (folder / "two").write_bytes(make_sketch(make_stranger(1)).to_bytes())
    (folder / "damaged").write_bytes(b"nothing")
    paths = {name: str(folder / name) for name in ("one", "two", "damaged")}
    return {**paths, "gone": "", "plant": str(marked.path("sketch"))}


def ask(task: str, folder: Path, **request: Any) -> dict[str, Any]:
    return TASKS[task](request, folder, silent)


def test_a_model_finds_its_asset_and_what_cannot_be_read_is_not_ruled_out(
    marked: Marked, entries: dict[str, str], tmp_path: Path
) -> None:
    request = {"model": str(marked.path("model")), "catalogue": "", "entries": entries}
    found = ask("screen", tmp_path, **request, among=list(entries))
    assert (found["alike"], found["unknown"]) == (["plant"], ["damaged", "gone"])
    assert ask("screen", tmp_path, **request, among=["one"])["alike"] == []
    strange = ask("screen", tmp_path, **{**request, "model": str(FOREIGN)}, among=["one", "plant"])
    assert strange["alike"] == strange["unknown"] == []
    assert len(strange["likely"]) == 1


def test_a_kept_index_says_the_same_and_grows(marked: Marked, entries: dict[str, str], tmp_path: Path) -> None:
    model = str(marked.path("model"))
    some = {name: entries[name] for name in ("one", "two", "damaged")}
    made = ask("index", tmp_path, catalogue="", entries=some)
    assert (made["assets"], made["damaged"]) == (2, ["damaged"])
    kept = tmp_path / "kept"
    (tmp_path / made["folder"]).rename(kept)
    rest = {"plant": entries["plant"]}
    found = ask("screen", tmp_path, model=model, catalogue=str(kept), entries=rest, among=["one", "plant"])
    assert found["alike"] == ["plant"]
    grown = ask("index", tmp_path, catalogue=str(kept), entries=rest)
    assert grown["assets"] == 3
    folder = str(tmp_path / grown["folder"])
    assert ask("screen", tmp_path, model=model, catalogue=folder, entries={}, among=["plant"])["alike"] == ["plant"]


def test_a_picture_finds_its_asset_and_one_without_landmarks_is_not_ruled_out(
    marked: Marked, entries: dict[str, str], tmp_path: Path
) -> None:
    found = ask(
        "screen",
        tmp_path,
        images=[str(shot_of(marked, tmp_path))],
        catalogue="",
        entries=entries,
        among=["one", "two", "plant"],
    )
    assert (found["alike"], found["unknown"]) == (["plant"], ["two"])
