"""The right one of many comes first: models whole, cut, merged, mirrored; pictures at any roll, over anything."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from engine.catalogue import catalogue as catalogues
from engine.catalogue.catalogue import Catalogue, screen_model, screen_pictures
from engine.catalogue.config import CONFIG
from engine.catalogue.entry import Entry
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate import strangers
from engine.lab.sim.attacks import model_attack
from engine.model import Float32, GaussianModel
from engine.numerics.similarity import mirror_model
from engine.raster import render_depth
from engine.registration.sketch import LOOK_ERRORS, SuspectIndex
from tests.parameters import few
from tests.pictures.rolling import rolled


@pytest.fixture(scope="module")
def entries(plant: GaussianModel) -> dict[str, Entry]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(strangers, "VIEWS", 24)  # half of what an embedding takes
        foreign = list(strangers.stranger_entries(0))
        return {"plant": strangers.entry_of(plant)} | {f"stranger {n}": entry for n, entry in enumerate(foreign)}


@pytest.fixture(scope="module")
def catalogue(entries: dict[str, Entry], tmp_path_factory: pytest.TempPathFactory) -> Catalogue:
    """With lists, as where there are many; saved and opened."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(catalogues, "CONFIG", replace(CONFIG, few=1000))
        made = Catalogue.build(list(entries)[1:], entries.__getitem__)
    folder = tmp_path_factory.mktemp("catalogue")
    made.save(folder)
    again = Catalogue.load(folder, growing=True)
    again.add("plant", entries["plant"])
    again.save(tmp_path_factory.mktemp("grown"))
    return Catalogue.load(sorted(folder.parent.glob("grown*"))[-1])


@pytest.mark.long
def test_a_lump_stands_for_several_assets(entries: dict[str, Entry], catalogue: Catalogue) -> None:
    assert len(catalogue) == len(entries) == strangers.RELATIVES + 1
    assert catalogue.unseen == []


@pytest.mark.parametrize(
    ("attack", "strength"),
    few(
        [("crop", 0.1), ("merge", 0.05)],
        [
            ("similarity", 3.0),
            ("crop", 0.1),
            ("prune_random", 0.9),
            ("merge", 0.25),
            ("merge", 0.05),
            ("noise_all", 0.1),
        ],
    ),
)
def test_a_derived_model_finds_its_source(
    catalogue: Catalogue, plant: GaussianModel, attack: str, strength: float
) -> None:
    found = screen_model(catalogue, SuspectIndex(model_attack(attack).apply(plant, strength, rng=3)))
    assert found[0].name == "plant"
    assert [each.alike for each in found[:2]] == [True, False]


def test_each_way_of_asking_finds_it_alone(catalogue: Catalogue, plant: GaussianModel) -> None:
    """Rare looks in a piece that lies in something else, places where no Gaussian is left."""
    suspect = SuspectIndex(mirror_model(model_attack("crop").apply(plant, 0.1, rng=3)))
    looks = catalogue._sums("looks", suspect.telling_looks / LOOK_ERRORS)
    assert catalogue.names[int(np.argmax(looks))] == "plant"
    merged = SuspectIndex(model_attack("merge").apply(plant, 0.05, rng=3))
    assert catalogue.like_model(merged)[0] == "plant"


def test_only_those_in_question_are_named(catalogue: Catalogue, plant: GaussianModel) -> None:
    found = screen_model(catalogue, SuspectIndex(plant), {"stranger 3", "stranger 4"})
    assert {each.name for each in found} <= {"stranger 3", "stranger 4"}
    assert not any(each.alike for each in found)


def picture(model: GaussianModel, seed: int) -> Float32:
    """From between the views of the bank, rolled, over a gradient of grey."""
    rng = np.random.default_rng(seed)
    camera = rolled(make_rig(model, 1, 800, 640, jitter=rng.random((1, 4)))[0], rng.uniform(-3, 3))
    image, alpha, _ = render_depth(model, camera)
    behind = np.linspace(0.9, 0.3, 640, dtype=np.float32)[:, None, None]
    return np.clip(image + (1.0 - alpha[..., None]) * behind, 0.0, 1.0).astype(np.float32)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_picture_finds_its_asset(catalogue: Catalogue, plant: GaussianModel, seed: int, mirrored: bool) -> None:
    shown = picture(plant, seed)
    found = screen_pictures(catalogue, [np.ascontiguousarray(shown[:, ::-1]) if mirrored else shown])
    assert found[0].name == "plant"
    assert found[1].votes < 0.6 * found[0].votes
    assert found[0].alike or seed != 1  # the others show little that stands out


def test_a_picture_of_something_else_shows_no_asset(catalogue: Catalogue) -> None:
    from skimage import data

    shown = data.chelsea()[::-1].astype(np.float32) / np.float32(255.0)
    found = screen_pictures(catalogue, [np.ascontiguousarray(shown)], {"plant"})
    assert all(each.votes < CONFIG.shown for each in found)
    assert screen_pictures(catalogue, [np.zeros((64, 64, 3), np.float32)]) == []


def test_an_asset_without_landmarks_is_told(entries: dict[str, Entry]) -> None:
    own = entries["plant"]
    few = Catalogue.build(["a", "b"], lambda name: Entry(own.sketch, own.seen if name == "a" else None))
    assert few.unseen == ["b"]
    np.testing.assert_array_equal(few.sketch("b").means, own.sketch.means)


def test_an_empty_catalogue_names_nobody(plant: GaussianModel, tmp_path: Path) -> None:
    empty = Catalogue.build([], lambda name: pytest.fail(name))
    empty.save(tmp_path)
    for each in (empty, Catalogue.load(tmp_path)):
        assert screen_model(each, SuspectIndex(plant.take(np.arange(500)))) == []
        assert screen_pictures(each, [picture(plant, 0)]) == []
