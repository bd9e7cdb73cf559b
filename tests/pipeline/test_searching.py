"""The search over records: what is asked is counted first, a damaged record hides nobody, the best answer is kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from engine.errors import InputError, MalformedRecordError
from engine.evaluate.marked_scene import MarkedScene
from engine.pipeline.sealing import OpenedRecord
from engine.pipeline.searching import Suspect, count_tries, search
from engine.pipeline.verification import VerifyConfig, verify_model
from engine.watermark.claim import Verdict

MODEL = VerifyConfig(route="model")


@dataclass(frozen=True, eq=False)
class Kept:
    """A candidate of the tests: a name, and what opening it gives."""

    name: str
    record: OpenedRecord | None

    def open(self) -> OpenedRecord:
        if self.record is None:
            raise MalformedRecordError("it is damaged")
        return self.record


def silent(stage: str, fraction: float) -> None:
    pass


def test_every_record_along_every_route_at_every_place_is_a_try() -> None:
    assert count_tries(3, ("model", "render"), VerifyConfig()) == 18
    assert count_tries(3, ("model",), VerifyConfig(), places=4) == 36
    assert count_tries(3, ("model",), VerifyConfig(tries=1000)) == 1000
    assert count_tries(3, ("model",), VerifyConfig(tries=2)) == 9, "a caller cannot count less than there is"


def test_routes_are_those_of_the_suspects_kind(scene: MarkedScene) -> None:
    model, picture = Suspect(scene.original), Suspect(None, [np.zeros((8, 8, 3), np.float32)])
    assert (model.routes("auto"), model.routes("render")) == (("model", "render"), ("render",))
    assert picture.routes("auto") == picture.routes("image") == ("image",)
    with pytest.raises(InputError, match="takes pictures"):
        model.routes("image")
    with pytest.raises(InputError, match="'model' takes a model"):
        picture.routes("model")
    with pytest.raises(InputError, match="empty"):
        Suspect(scene.original.take(np.arange(0))).routes("auto")


def test_the_best_answer_is_kept_and_a_damaged_record_hides_nobody(scene: MarkedScene, other: MarkedScene) -> None:
    asked = [Kept("damaged", None), Kept("other", other.opened), Kept("right", scene.opened)]
    told: list[str] = []
    found = search(Suspect(scene.marked), asked, MODEL, lambda stage, fraction: told.append(stage))
    assert [outcome.candidate.name for outcome in found.outcomes] == ["damaged", "other", "right"]
    assert isinstance(found.outcomes[0].error, MalformedRecordError)
    assert found.best is not None
    assert (found.best.candidate.name, found.tries) == ("right", 9)
    assert found.best.claim is not None
    assert (found.best.claim.verdict, found.best.claim.tries) == (Verdict.MARKED, 9)
    # The same evidence as asked alone; only the tries differ.
    alone = verify_model(scene.marked, scene.opened, MODEL).claim
    assert found.best.claim.z == alone.z
    assert found.best.claim.log10_false_claim == pytest.approx(alone.log10_false_claim + np.log10(3))
    assert [outcome.opened for outcome in found.outcomes] == [None, None, scene.opened], "whole models are let go"
    assert set(told) == {f"record {k} of 3" for k in (1, 2, 3)}
    assert {"open record", "register", "model"} <= set(found.seconds_by_stage)


def test_it_may_stop_at_the_first_mark_but_counts_all(scene: MarkedScene, other: MarkedScene) -> None:
    asked = [Kept("right", scene.opened), Kept("other", other.opened)]
    found = search(Suspect(scene.marked), asked, MODEL, silent, stop_at_first=True)
    assert [outcome.candidate.name for outcome in found.outcomes] == ["right"]
    assert found.tries == 6
    assert search(Suspect(scene.marked), [], MODEL, silent).best is None
