from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from engine.formats import read_model, write_model
from engine.lab.sim.attacks import model_attack
from service.problems import Problem
from service.work import verification
from tests.service.claims.cases import reply as reply_of
from tests.service.claims.test_searched import unrelated
from tests.service.work.conftest import FOREIGN, Ask, Marked, checks, shot_of


def five(reply: dict[str, Any]) -> list[bool | None]:
    """Outcomes of the first checks."""
    return [checks(reply)[code] for code in ("record_intact", "owner_key", "derived", "mark", "evidence")]


def test_a_marked_model_is_told_with_pictures(verify: Ask, marked: Marked, tmp_path: Path) -> None:
    reply = verify(model=str(marked.path("model")))
    claim = reply["claim"]
    assert reply["asset"] == "plant"
    assert (claim["verdict"], claim["message"], claim["copy"]) == ("marked", "c0ffee42", "acme")
    assert reply["registered_message"] == "c0ffee42"
    assert reply["record"]["record_id"] == marked.reply["record_id"]
    assert reply["record"]["registered_at"] == "2026-01-02T03:04:05+00:00"
    assert reply["subject"] == {"format": "ply", "gaussians": len(read_model(marked.original).model), "pictures": 0}
    assert five(reply) == [True] * 5
    assert set(reply["files"]) == {"heatmap", "suspect", "asset", "difference"}
    for name in reply["files"].values():
        with Image.open(tmp_path / name) as picture:
            assert max(picture.size) <= 800
            assert picture.size[0] == 640


def test_derived_but_unmarked(verify: Ask, marked: Marked) -> None:
    reply = verify(model=str(marked.original))
    assert reply["claim"]["verdict"] == "not_marked"
    assert reply["claim"]["derived"]
    assert five(reply) == [True, True, True, False, True]


@pytest.mark.long
def test_not_derived(verify: Ask) -> None:
    reply = verify(model=str(FOREIGN))
    assert reply["claim"]["verdict"] == "inconclusive"
    assert five(reply) == [True, True, None, None, False]


def test_tampered_record(verify: Ask, marked: Marked, tmp_path: Path) -> None:
    data = bytearray(marked.path("record").read_bytes())
    data[len(data) // 2] ^= 1
    (tmp_path / "altered.record").write_bytes(data)
    candidates = [marked.candidate(record=tmp_path / "altered.record")]
    reply = verify(model=str(marked.path("model")), candidates=candidates)
    assert (reply["asset"], reply["claim"], reply["record"], reply["files"]) == ("plant", None, None, {})
    assert five(reply) == [False, None, None, None, None]
    assert reply["tried"][0]["verdict"] == "could_not_check"


def test_wrong_key(verify: Ask, marked: Marked) -> None:
    reply = verify(model=str(marked.path("model")), candidates=[marked.candidate(key="33" * 16 + "44" * 16)])
    assert reply["claim"] is None
    assert five(reply) == [True, False, None, None, None]


def test_too_little_evidence(verify: Ask, marked: Marked, tmp_path: Path) -> None:
    scrap = read_model(marked.path("model")).model.take(np.arange(20_000, 20_090))
    write_model(scrap, tmp_path / "scrap.ply")
    reply = verify(model=str(tmp_path / "scrap.ply"), false_claim_rate=1e-300)
    assert reply["claim"]["verdict"] == "inconclusive"
    assert checks(reply)["evidence"] is False


def test_the_right_one_of_several_and_all_tries_count(verify: Ask, marked: Marked, tmp_path: Path) -> None:
    """Two records are tested, along two routes each."""
    suspect = tmp_path / "suspect.ply"
    moved = model_attack("similarity").apply(read_model(marked.path("model")).model, 3.0, rng=1)
    write_model(model_attack("crop").apply(moved, 0.3, rng=2), suspect)
    alone = verify(model=str(suspect))
    candidates = [marked.candidate("stolen", key="33" * 16 + "44" * 16), marked.candidate("mine")]
    reply = verify(model=str(suspect), candidates=candidates)
    assert reply["asset"] == "mine"
    assert [each["asset"] for each in reply["tried"]] == ["stolen", "mine"]
    assert (alone["tries"], reply["tries"], reply["claim"]["tries"]) == (9, 18, 18)
    worse = reply["claim"]["log10_false_claim"] - alone["claim"]["log10_false_claim"]
    assert worse == pytest.approx(math.log10(2), abs=1e-6)


def test_stopping_at_the_first_is_a_choice(verify: Ask, marked: Marked) -> None:
    candidates = [marked.candidate("one"), marked.candidate("two")]
    model = str(marked.path("model"))
    soon = verify(model=model, candidates=candidates, route="model")
    late = verify(model=model, candidates=candidates, route="model", stop_at_first=False)
    assert [each["asset"] for each in soon["tried"]] == ["one"]
    assert [each["asset"] for each in late["tried"]] == ["one", "two"]
    assert sorted([late["asset"], *(each["asset"] for each in late["others"])]) == ["one", "two"]
    assert soon["claim"]["tries"] == late["claim"]["tries"] == 12  # the bar was set before either was looked at


def test_what_was_not_recognized_is_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is read of it but noise. The rest follow by what they tell, as many as are handed out."""
    monkeypatch.setattr(verification, "MOST_OTHERS", 2)
    found, nothing = reply_of("inconclusive")["claim"], unrelated()["claim"]
    claims = {"first": found, "less": found, "more": found, "least": found, "strange": nothing}
    outcomes = [
        SimpleNamespace(
            candidate=SimpleNamespace(asset=name), worth=worth, claim=SimpleNamespace(to_json=lambda c=claim: c)
        )
        for (name, claim), worth in zip(claims.items(), (9, 3, 4, 2, 5), strict=True)
    ]
    answer: Any = SimpleNamespace(search=SimpleNamespace(outcomes=outcomes), best=outcomes[0])
    assert [each["asset"] for each in verification._others(answer)] == ["more", "less"]


def test_without_candidates_there_is_nothing_to_say(verify: Ask) -> None:
    reply = verify(model=str(FOREIGN), candidates=[])
    assert (reply["asset"], reply["claim"], reply["tries"]) == (None, None, 0)
    assert checks(reply) == {"evidence": False}


def test_a_screenshot_from_an_unknown_camera(verify: Ask, marked: Marked, tmp_path: Path) -> None:
    reply = verify(images=[str(shot_of(marked, tmp_path))])
    assert reply["claim"]["verdict"] == "marked"
    assert reply["subject"] == {"format": "pictures", "gaussians": None, "pictures": 1}
    assert set(checks(reply).values()) == {True}
    with Image.open(tmp_path / reply["files"]["suspect"]) as picture:
        assert picture.size == (800, 569)


@pytest.mark.long
def test_a_picture_of_something_else(verify: Ask, tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (200, 200, 3), dtype=np.uint8)
    Image.fromarray(noise).save(tmp_path / "noise.png")
    reply = verify(images=[str(tmp_path / "noise.png")])
    assert reply["claim"]["verdict"] == "inconclusive"
    assert five(reply) == [True, True, None, None, False]


@pytest.mark.parametrize("both", [True, False])
def test_a_suspect_is_a_model_or_pictures(verify: Ask, both: bool, marked: Marked) -> None:
    with pytest.raises(Problem, match="one model, or pictures") as caught:
        verify(model=str(marked.original) if both else None, images=[str(marked.original)] if both else [])
    assert caught.value.kind == "invalid-request"


def test_the_map_is_the_engines_and_the_claim_counts_its_regions(verify: Ask, marked: Marked, tmp_path: Path) -> None:
    said = verify(model=str(marked.path("model")))["regions"]
    assert said["marked"] > 10
    assert (said["altered"], said["unclear"], said["unseen"], said["pieces"]) == (0, 0, 0, 1)
    drawn = np.asarray(Image.open(tmp_path / "heatmap.png"), dtype=np.int64)[:480]  # the map; its legend follows
    orange = drawn[..., 0] > 2 * drawn[..., 2] + 20
    assert orange.mean() > 0.05
    assert orange.sum() > 0.7 * (drawn.min(axis=2) < 200).sum(), "of what is not paper"
    unmarked = verify(model=str(marked.original))["regions"]
    assert unmarked["marked"] == 0
    assert unmarked["altered"] > 0.95 * said["marked"]
    drawn = np.asarray(Image.open(tmp_path / "heatmap.png"), dtype=np.int64)[:480]
    assert (drawn[..., 0] > 2 * drawn[..., 2] + 20).mean() < 1e-3
