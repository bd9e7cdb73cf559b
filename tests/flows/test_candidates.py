"""The search over records: a damaged one hides nobody, the best answer is kept, copies of one asset share a reading."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import engine.flows.trace.candidates as candidates
import engine.flows.verify.search as searching
import engine.flows.verify.suspect_evidence as suspect_evidence
from engine.errors import MalformedRecordError
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.regions.region_search import locate_mark
from engine.flows.trace.candidates import Outcome, search
from engine.flows.verify.search import Suspect, VerifyConfig, verify, verify_model
from engine.lab.evaluate.bench.attacks import to_8_bit
from engine.lab.evaluate.marked_scene import MarkedScene
from engine.lab.sim.adversaries.collusion import collude
from engine.model import GaussianModel
from engine.raster import render
from engine.watermark.claim import Verdict
from engine.watermark.rates import DRAWS
from tests.flows.conftest import FiveCopies

MODEL = VerifyConfig(route="model")


@dataclass(frozen=True, eq=False)
class Kept:
    """A candidate of the tests: a name, and what opening it gives."""

    name: str
    record: OpenedRecord | None
    original: str
    opened: list[str] = field(default_factory=list)

    def open(self) -> OpenedRecord:
        self.opened.append(self.name)
        if self.record is None:
            raise MalformedRecordError("it is damaged")
        return self.record


def silent(stage: str, fraction: float) -> None:
    pass


def test_the_best_answer_is_kept_and_a_damaged_record_hides_nobody(scene: MarkedScene, other: MarkedScene) -> None:
    asked = [Kept("damaged", None, "a"), Kept("other", other.opened, "b"), Kept("right", scene.opened, "c")]
    told: list[str] = []
    found = search(Suspect(scene.marked), asked, MODEL, lambda stage, fraction: told.append(stage))
    assert [outcome.candidate.name for outcome in found.outcomes] == ["damaged", "other", "right"]
    assert isinstance(found.outcomes[0].error, MalformedRecordError)
    assert found.best is not None
    assert (found.best.candidate.name, found.tries) == ("right", 18)
    assert found.best.claim is not None
    assert (found.best.claim.verdict, found.best.claim.tries) == (Verdict.MARKED, 18 * DRAWS)
    # The same evidence as asked alone; only the tries differ.
    alone = verify_model(scene.marked, scene.opened, MODEL).claim
    assert found.best.claim.z == alone.z
    assert found.best.claim.log10_false_claim == pytest.approx(alone.log10_false_claim + np.log10(3))
    assert [outcome.opened for outcome in found.outcomes] == [None, None, scene.opened], "whole models are let go"
    assert [outcome.found is None for outcome in found.outcomes] == [True, True, False]
    assert set(told) == {f"record {k} of 3" for k in (1, 2, 3)}
    assert {"open record", "register", "model"} <= set(found.seconds_by_stage)


def test_what_was_read_as_another_copy_never_stands_first(scene: MarkedScene) -> None:
    claim = verify_model(scene.marked, scene.opened, MODEL).claim
    asked = Kept("right", scene.opened, "a")
    unread = Outcome(asked, error=MalformedRecordError("it is damaged"))
    partly, weak = Outcome(asked, claim, whole=False), Outcome(asked, replace(claim, verdict=Verdict.INCONCLUSIVE))
    assert unread.worth < partly.worth < weak.worth < Outcome(asked, claim).worth


def test_it_may_stop_at_the_first_mark_but_counts_all(scene: MarkedScene, other: MarkedScene) -> None:
    asked = [Kept("right", scene.opened, "a"), Kept("other", other.opened, "b")]
    found = search(Suspect(scene.marked), asked, MODEL, silent, stop_at_first=True)
    assert [outcome.candidate.name for outcome in found.outcomes] == ["right"]
    assert found.tries == 12
    assert search(Suspect(scene.marked), [], MODEL, silent).best is None


@dataclass(frozen=True)
class Copies:
    models: list[GaussianModel]
    candidates: list[Kept]

    def picture(self, number: int) -> Suspect:
        """Two pictures of a copy, whose cameras are known."""
        cameras = [camera.resized(256, 256) for camera in opened_of(self, 0).cameras[:2]]
        return Suspect(None, [to_8_bit(render(self.models[number], camera)) for camera in cameras], cameras)


def opened_of(copies: Copies, number: int) -> OpenedRecord:
    opened = copies.candidates[number].record
    assert opened is not None
    return opened


@pytest.fixture
def copies(five_copies: FiveCopies, small_renders: None) -> Copies:
    return Copies(five_copies.models, [Kept(each.copy, each, "plant") for each in five_copies.opened])


@pytest.fixture
def earlier(earlier_copies: FiveCopies, small_renders: None) -> Copies:
    """Of format 2: read as one copy, each is told less by pictures."""
    return Copies(earlier_copies.models, [Kept(each.copy, each, "plant") for each in earlier_copies.opened])


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often a suspect is registered, rendered and read as pictures."""
    counted: Counter[str] = Counter()

    def count(module: ModuleType, name: str) -> None:
        read = getattr(module, name)

        def counting(*args: Any, **more: Any) -> Any:
            counted[name] += 1
            return read(*args, **more)

        monkeypatch.setattr(module, name, counting)

    count(searching, "register")
    count(suspect_evidence, "read_renders")
    count(suspect_evidence, "read_pictures")
    return counted


def test_copies_share_a_reading_and_each_is_told_what_it_would_be_alone(copies: Copies, reads: Counter[str]) -> None:
    together = collude(copies.models[0], "mean", np.random.default_rng(1), others=[copies.models[3]])
    found = search(Suspect(together), copies.candidates, VerifyConfig(), silent)
    assert reads == {"register": 1}, "and no render is asked where Gaussians show a mark"
    assert all(each.marked for each in found.outcomes), "by the layer that all copies share"
    assert [each.named for each in found.outcomes] == [True, False, False, True, False]
    for outcome in found.outcomes:
        assert outcome.candidate.record is not None
        assert outcome.claim is not None
        alone = verify(Suspect(together), outcome.candidate.record, replace(MODEL, tries=found.tries)).claim
        assert outcome.claim.z == pytest.approx(alone.z, rel=1e-9)
        assert outcome.claim.copy_z == pytest.approx(alone.copy_z, rel=1e-9)
        assert outcome.claim.log10_false_claim == pytest.approx(alone.log10_false_claim, rel=1e-9)
        assert (outcome.claim.verdict, outcome.claim.derived_fraction) == (alone.verdict, alone.derived_fraction)
    assert [each.found is not None for each in found.outcomes].count(True) == 1


def test_of_copies_none_is_asked_behind_the_first_that_is_marked(copies: Copies) -> None:
    found = search(Suspect(copies.models[1]), copies.candidates, VerifyConfig(), silent, stop_at_first=True)
    assert [each.candidate.name for each in found.outcomes] == ["buyer 0", "buyer 1"]
    assert [len(each.opened) for each in copies.candidates] == [1, 1, 0, 0, 0]
    assert found.tries == 45
    assert found.best is not None
    assert found.best.candidate.name == "buyer 1"
    assert found.best.opened is not None
    assert found.best.found is not None
    regions = locate_mark(Suspect(copies.models[1]), found.best.opened, found.best.found)
    assert regions.claimed
    assert regions.summary()["share"]["marked"] > 0.9, "in its own cells"


def test_an_unmarked_original_is_read_once_and_told_so_by_each(
    copies: Copies, small_plant: GaussianModel, reads: Counter[str]
) -> None:
    found = search(Suspect(small_plant), copies.candidates, VerifyConfig(), silent)
    assert reads["register"] == 1
    assert reads["read_renders"] <= 1
    assert {each.claim.verdict for each in found.outcomes if each.claim} == {Verdict.NOT_MARKED}


def test_copies_of_format_2_are_told_apart_by_their_own_marks(earlier: Copies, reads: Counter[str]) -> None:
    together = collude(earlier.models[0], "mean", np.random.default_rng(1), others=[earlier.models[2]])
    found = search(Suspect(together), earlier.candidates, VerifyConfig(), silent)
    assert reads == {"register": 1}, "nothing is rendered for the one without a mark, once others have one"
    assert [each.marked for each in found.outcomes] == [True, False, True]
    assert {each.claim.copy_named for each in found.outcomes if each.claim} == {None}


def test_a_picture_of_one_copy_names_it_in_one_reading(copies: Copies, reads: Counter[str]) -> None:
    suspect = copies.picture(3)
    found = search(suspect, copies.candidates, VerifyConfig(), silent, stop_at_first=True)
    assert reads == {"read_pictures": 1}
    assert [each.named for each in found.outcomes] == [False, False, False, True]
    read_as_alone(found, suspect, "buyer 3")


def read_as_alone(found: Any, suspect: Suspect, name: str) -> None:
    """The best answer is of this copy, with its own cells, in full."""
    assert found.best.candidate.name == name
    assert found.best.claim == verify(suspect, found.best.candidate.record, VerifyConfig(tries=found.tries)).claim


def test_a_picture_of_a_copy_of_format_2_names_it_after_two_readings(earlier: Copies, reads: Counter[str]) -> None:
    suspect = earlier.picture(1)
    found = search(suspect, earlier.candidates, VerifyConfig(), silent, stop_at_first=True)
    assert reads == {"read_pictures": 2}, "once for all, once for the one that stands out"
    assert [each.whole for each in found.outcomes] == [True, True]
    read_as_alone(found, suspect, "buyer 1")


def test_of_a_faint_picture_the_copy_that_stands_out_alone_is_read_by_itself(
    earlier: Copies, small_plant: GaussianModel, reads: Counter[str]
) -> None:
    camera = opened_of(earlier, 0).cameras[0].resized(96, 96)
    faint = np.float32(0.5) * (render(earlier.models[1], camera) + render(small_plant, camera))
    found = search(Suspect(None, [to_8_bit(faint)], [camera]), earlier.candidates, VerifyConfig(), silent)
    assert reads == {"read_pictures": 2}
    assert [each.whole for each in found.outcomes] == [True, True, False]
    assert not any(each.marked for each in found.outcomes)


def test_a_mark_that_a_full_reading_does_not_confirm_ends_nothing(
    earlier: Copies, monkeypatch: pytest.MonkeyPatch
) -> None:
    doubted = verify(earlier.picture(1), opened_of(earlier, 0), VerifyConfig())
    monkeypatch.setattr(candidates, "verify", lambda *_: doubted)
    found = search(earlier.picture(1), earlier.candidates, VerifyConfig(), silent, stop_at_first=True)
    assert len(found.outcomes) == 3, "those behind it are asked, too"
    assert not any(each.marked for each in found.outcomes)


def test_a_picture_of_none_is_read_once(copies: Copies, small_plant: GaussianModel, reads: Counter[str]) -> None:
    suspect = Copies([small_plant], copies.candidates).picture(0)
    found = search(suspect, copies.candidates, VerifyConfig(), silent, stop_at_first=True)
    assert reads == {"read_pictures": 1}
    assert not any(each.marked for each in found.outcomes)
    assert found.best is not None
    assert found.best.candidate.name == "buyer 0", "the one that was read in full"


def test_a_damaged_copy_and_one_of_another_reference_hide_nobody(copies: Copies, scene: MarkedScene) -> None:
    """What is said to be one original may have been pruned otherwise, or be a lie: then it is read by itself."""
    asked = [Kept("damaged", None, "plant"), Kept("pruned", scene.opened, "plant"), *copies.candidates[:2]]
    found = search(Suspect(copies.models[1]), asked, VerifyConfig(), silent, stop_at_first=True)
    assert [type(each.error).__name__ for each in found.outcomes] == ["MalformedRecordError", *3 * ["NoneType"]]
    assert found.best is not None
    assert found.best.candidate.name == "buyer 1"
    other = search(Suspect(scene.marked), asked, VerifyConfig(), silent).best
    assert other is not None
    assert other.candidate.name == "pruned"
