"""Pictures that do not carry the mark: the bench shows every kind, from the right model, and counts what is said."""

from collections.abc import Iterator
from itertools import islice
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from engine.formats import read_model
from engine.lab.evaluate.bench import foreign
from engine.lab.evaluate.bench.foreign import SIZES, posted_pictures
from engine.model import Float32, GaussianModel
from tests.scenes import sparse_plant

LUMP = "a lump"


@pytest.fixture(scope="module")
def plant() -> GaussianModel:
    return read_model(sparse_plant(every=20)).model


@pytest.mark.parametrize("other", ["b.splat", None])
def test_every_kind_is_shown_as_often_from_what_does_not_carry_the_mark(
    other: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def mark(path: str, config: Any, seed: int = 0) -> SimpleNamespace:
        return SimpleNamespace(name=path, original=f"{path} unmarked", marked=f"{path} under {seed}", opened=path)

    def verify(pictures: list[str], record: str, config: Any) -> SimpleNamespace:
        seen.append((pictures[0], record))
        claim = SimpleNamespace(derivation=SimpleNamespace(derived="a.splat" in pictures[0]), verdict=SimpleNamespace())
        figures = {"bit_accuracy": 0.5, "z": 0.0, "log10_false_claim": 0.0, "derived_fraction": None}
        vars(claim).update(figures)
        claim.verdict.value = "inconclusive"
        return SimpleNamespace(claim=claim, seconds=1.0)

    seen: list[tuple[str, str]] = []
    monkeypatch.setattr(foreign, "mark_scene", mark)
    monkeypatch.setattr(foreign, "make_stranger", lambda number: LUMP)
    monkeypatch.setattr(foreign, "_photographs", lambda rng: iter(["a photograph"] * 100))
    monkeypatch.setattr(foreign, "posted_pictures", lambda model, count, rng: iter([model] * count))
    monkeypatch.setattr(foreign, "verify_images", verify)
    rows = foreign.measure_foreign("a.splat", 3, "fast", 24, other)
    shown = [picture for picture, _ in seen]
    kinds = ["a.splat unmarked", *(["b.splat under 4"] if other else []), LUMP, "a photograph"]
    assert shown == [kind for kind in kinds for _ in range(24 // len(kinds))]
    assert {record for _, record in seen} == {"a.splat"}
    assert [row["recognised"] for row in rows] == ["a.splat" in picture for picture in shown]
    assert {row["source"] for row in rows} == {"unmarked", LUMP, "a photograph"} | (
        {"another scene"} if other else set()
    )


def test_posted_pictures_show_the_model_over_something(plant: GaussianModel) -> None:
    def some(model: GaussianModel, seed: int) -> list[Float32]:
        return list(posted_pictures(model, 4, np.random.default_rng(seed)))

    faint = plant.with_(opacity_logits=np.full_like(plant.opacity_logits, -20.0))
    shown, again, without = some(plant, 1), some(plant, 1), some(faint, 1)
    assert {picture.shape[1::-1] for picture in shown} <= set(SIZES)
    for picture, same, empty in zip(shown, again, without, strict=True):
        np.testing.assert_array_equal(picture, same)
        np.testing.assert_allclose(picture * 255, np.rint(picture * 255), atol=1e-3)
        assert np.abs(picture - empty).mean() > 0.01, "the model is seen"
        assert (empty.mean(axis=2) > 0.02).all(), "and what is behind it is not black"


def test_a_quarter_of_the_posted_pictures_is_turned_over(plant: GaussianModel, monkeypatch: pytest.MonkeyPatch) -> None:
    ramp = np.tile(np.linspace(0, 1, 32, dtype=np.float32), (32, 1))
    drawn = (np.repeat(ramp[..., None], 3, axis=2), np.ones_like(ramp), None)
    monkeypatch.setattr("engine.lab.evaluate.bench.foreign.render_depth", lambda model, camera: drawn)
    monkeypatch.setattr("engine.lab.evaluate.bench.foreign.SIZES", ((32, 32),))
    posted = posted_pictures(plant, 200, np.random.default_rng(0))
    assert 35 < sum(picture[:, 0].mean() > picture[:, -1].mean() for picture in posted) < 65


def test_photographs_fill_the_picture_and_differ() -> None:
    supply: Iterator[Float32] = foreign._photographs(np.random.default_rng(0))
    some = list(islice(supply, 6))
    for picture in some:
        assert picture.shape[1::-1] in SIZES
        assert 0.0 <= picture.min() < picture.max() <= 1.0
        assert picture.std() > 0.02
    assert len({picture.tobytes() for picture in some}) == len(some)
