"""Progress of the whole job: over the stages that the tasks really go through, and never backwards."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.flows.views.camera_rig import make_rig
from engine.formats import read_model
from engine.raster import render
from engine.usecases.files import write_picture
from service.http.job_responses import course
from service.jobs.port import Job, State
from service.work.tasks import TASKS
from tests.service.work.conftest import Marked

TWICE = 0.03
"""A step back that is not visible: colours are quantised in two passes."""


def at(kind: str, stage: str, fraction: float, state: State = State.RUNNING, **request: Any) -> float | None:
    return course(Job("job", "tenant", "key", kind, state, request, stage, fraction))


def totals(kind: str, stages: list[tuple[str, float]], **request: Any) -> list[float]:
    found = [at(kind, stage, fraction, **request) for stage, fraction in stages]
    known = [total for total in found if total is not None]
    assert len(known) == len(found), [stage for (stage, _), total in zip(stages, found, strict=True) if total is None]
    back = [now for now, (before, after) in zip(stages[1:], pairwise(known), strict=True) if after < before - TWICE]
    assert back == []
    return known


def test_an_embedding_is_told_from_its_first_stage_to_its_last(marked: Marked) -> None:
    stages = [("screen", 0.1), ("screen", 1.0), *marked.stages, ("commit", 0.0)]
    output = totals("embed", stages, profile="fast")
    assert (output[0] < 0.01, output[-1]) == (True, 1.0)
    assert len(set(output)) > 15


@pytest.mark.parametrize("pictures", [0, 1])
def test_a_check_is_told_from_its_first_stage_to_its_last(marked: Marked, tmp_path: Path, pictures: int) -> None:
    model = read_model(marked.path("model")).model
    shot = tmp_path / "shot.png"
    write_picture(np.clip(render(model, make_rig(model, 1, 600, 400)[0]), 0, 1), shot, shot, 90)
    request = {"false_claim_rate": 1e-9, "spz_frame": "auto", "candidates": [marked.candidate()]}
    request |= {"images": [str(shot)]} if pictures else {"model": str(marked.path("model"))}
    stages = [("screen", 0.1)]
    TASKS["verify"](request, tmp_path, lambda stage, fraction: stages.append((stage, fraction)))
    output = totals("verify", [*stages, ("commit", 1.0)], images=["x"] * pictures)
    assert output[-1] == 1.0


def test_what_a_stage_has_reached_is_no_stage_of_its_own() -> None:
    total = at("embed", "prune", 0.5)
    assert total is not None
    assert at("embed", "prune: 37.5 dB", 0.5) == total


def test_a_choice_takes_its_time() -> None:
    assert at("embed", "look", 0.0, profile="fast") == at("embed", "choose", 1.0, profile="fast")
    chosen = at("embed", "look", 0.0, profile="auto")
    assert chosen is not None
    assert chosen > 0.35


def test_pruning_to_a_budget_takes_its_time() -> None:
    assert at("embed", "prune", 1.0, budget=None) == at("embed", "prune", 1.0) == at("embed", "quantize", 0.0)
    half = at("embed", "prune: 36.7 dB", 0.5, budget=35.0)
    assert half is not None
    assert 0.4 < half < 0.5


def test_what_nobody_knows_is_not_said() -> None:
    assert at("embed", "", 0.5, State.QUEUED) == 0.0
    assert at("embed", "look", 0.5, State.SUCCEEDED) == at("embed", "look", 0.5, State.DISPUTED) == 1.0
    assert at("embed", "look", 0.5, State.FAILED) is None
    assert at("verify", "record 3 of 41", 0.1) is None, "its step says it"
    assert at("embed", "compile", 0.5, profile="fast") is None
    assert at("verify", "render", 0.5) is None
    assert at("verify", "find camera", 0.5, images=["a", "b"]) is None
    assert at("dispute", "read", 0.5) is None
