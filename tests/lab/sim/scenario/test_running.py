"""Scenarios played on a real scene: every kind of step does something, and every mark is looked for after it."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.sim.scenario import Run, StepResult, read_scenario, run_scenario
from tests.scenes import sparse_plant

TRAIN = Path(__file__).parents[3] / "data" / "train_1000.ply"

STEPS = f"""
seed = 5
[film]
size = [160, 120]
frames = 2
[[objects]]
name = "plant"
model = "plant.splat"
bits = 16
profile = "fast"
[[steps]]
do = "recolor"
gain = [0.5, 1.0, 1.5]
select = {{ sphere = [0, 0, 0, 0.4] }}
[[steps]]
do = "delete"
inpaint = false
select = {{ box = [-2, -2, -2, 0, 2, 2] }}
[[steps]]
do = "press"
seconds = 0.1
frames = 2
resolution = 6
share = 0.8
[[steps]]
do = "add"
model = "{TRAIN}"
name = "train"
at = [0, 0, 2]
[[steps]]
do = "pictures"
known_cameras = true
size = [256, 192]
on = "plant"
attacks = [["jpeg", 50]]
[[steps]]
do = "remove"
name = "plant"
"""


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, list[StepResult]]:
    path = tmp_path_factory.mktemp("scenario") / "s.toml"
    path.write_text(STEPS)
    path.with_name("plant.splat").write_bytes(sparse_plant())
    reports: list[StepResult] = []
    return run_scenario(read_scenario(path), on_result=reports.append), reports


def test_every_step_was_read(played: tuple[Run, list[StepResult]]) -> None:
    run, reports = played
    assert [result.label for result in run.results] == [result.label for result in reports]
    verdicts = [found.verdict for result in run.results for found in result.findings]
    assert verdicts[:4] == ["marked"] * 4
    assert verdicts[-1] != "marked"  # what was taken out is not found
    assert len(verdicts) == 7


def test_every_step_changed_something(played: tuple[Run, list[StepResult]]) -> None:
    run, _ = played
    pictures = [result.picture[:80] for result in run.results]  # above the caption
    for before, after in itertools.pairwise(pictures):
        assert np.abs(before.astype(int) - after).max() > 20
    assert len(run.frames) >= 2 * len(run.results) - 2
    assert len(run.model) == 1000  # only what was added is left


def test_a_step_that_does_not_fit_is_named(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text(f'[[objects]]\nmodel = "{TRAIN}"\nbits = 0\n[[steps]]\ndo = "remove"\nname = "nobody"\n')
    with pytest.raises(InputError, match=r"step '1\. remove nobody': no object is called 'nobody'"):
        run_scenario(read_scenario(path))
