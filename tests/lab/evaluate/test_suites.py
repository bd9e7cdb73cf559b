"""Suites are found by name, know their options, and their cells call functions that are there."""

import importlib
import inspect
import json

import pytest

from engine.errors import InputError
from engine.flows.embed.profiles import EmbedConfig
from engine.lab.evaluate.measurements import MEASUREMENTS
from engine.lab.evaluate.study import Cell, Options
from engine.lab.evaluate.suites import PROTOCOLS, STUDIES, find_study, summaries

SCENES = ("a/plant.splat", "b/plant.splat")


def cells_of(name: str, scenes: tuple[str, ...] = SCENES) -> list[Cell]:
    return find_study(name).cells(Options(scenes))


@pytest.mark.parametrize("name", [*MEASUREMENTS, *STUDIES, *PROTOCOLS])
def test_functions_take_what_their_cells_say(name: str) -> None:
    cells = cells_of(name)
    assert len({cell.name for cell in cells}) == len(cells)
    for cell in cells:
        module, _, function = cell.work.partition(":")
        found = getattr(importlib.import_module(module), function)
        inspect.signature(found).bind(**json.loads(json.dumps(cell.arguments)))


def test_every_suite_is_listed_and_no_other_is_found() -> None:
    assert list(summaries()) == [*STUDIES, *PROTOCOLS, *MEASUREMENTS]
    assert all(find_study(name).name == name for name in summaries())
    with pytest.raises(InputError, match="there is no suite 'table7'"):
        find_study("table7")


def test_trials_count_what_the_suite_counts() -> None:
    foreign = find_study("foreign")
    assert foreign.knows == {"profile", "trials"}
    assert foreign.cells(Options(SCENES))[0].arguments["pictures"] == 200
    assert foreign.report([], Options(SCENES, trials=7)).summary == {"profile": "fast", "pictures": 7}


def test_scenes_stand_alone_together_or_beside_another() -> None:
    assert [cell.arguments["scene"] for cell in cells_of("budgets")] == list(SCENES)
    assert [cell.arguments["scenes"] for cell in cells_of("screening")] == [list(SCENES)]
    assert [cell.arguments["other"] for cell in cells_of("screenshots")] == ["b/plant.splat", "a/plant.splat"]
    assert cells_of("screenshots", SCENES[:1])[0].arguments["other"] is None


def test_budgets_are_fitted_where_they_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def mark(scene: str, config: EmbedConfig, *, seed: int) -> None:
        raise LookupError(config.device)

    monkeypatch.setattr("engine.lab.evaluate.bench.marking.mark_scene", mark)
    assert "device" in find_study("budgets").knows
    with pytest.raises(LookupError, match="cuda"):
        find_study("budgets").cells(Options(SCENES, device="cuda"))[0].run()


def test_the_report_of_a_measurement_is_its_rows() -> None:
    rows = [{"cell": "x", "z": 1.0, "stages": {"a": 1}}, {"cell": "y", "z": 2.0, "bits": 32}]
    (section,) = find_study("budgets").report(rows, Options(SCENES)).sections
    (table,) = section.tables
    assert (list(table.columns), table.rows) == (["cell", "z", "bits"], [["x", 1.0, ""], ["y", 2.0, 32]])
