"""Every bench is a cell that a study could run: its function is there and takes what the command gives it."""

import importlib
import inspect
import json

import pytest

from engine.errors import InputError
from engine.lab.evaluate.bench.benches import BENCHES, bench_cells
from engine.lab.evaluate.study import Cell

SCENES = ("a/plant.splat", "b/plant.splat")
ASKED = {"profile": "fast", "repeats": 3, "trials": None, "size": [64, 48], "colors_only": False}


def cells_of(name: str, scenes: tuple[str, ...] = SCENES, *settings: str) -> list[Cell]:
    return bench_cells(name, scenes, ASKED, seed=0, settings=settings, spare="spare.splat")[0]


@pytest.mark.parametrize("name", BENCHES)
def test_functions_take_what_their_cells_say(name: str) -> None:
    cells = cells_of(name)
    assert len({cell.name for cell in cells}) == len(cells)
    for cell in cells:
        module, _, function = cell.work.partition(":")
        found = getattr(importlib.import_module(module), function)
        inspect.signature(found).bind(**json.loads(json.dumps(cell.arguments)))


def test_a_bench_counts_what_it_counts() -> None:
    assert cells_of("finetune")[0].arguments["epochs"] == 500
    told = bench_cells("truth", SCENES, {**ASKED, "trials": 7}, seed=0, settings=(), spare="")[1]
    assert told == {"profile": "fast", "keys": 7}


def test_scenes_stand_alone_together_or_beside_another() -> None:
    assert [cell.arguments["scene"] for cell in cells_of("fidelity")] == list(SCENES)
    assert [cell.arguments["scenes"] for cell in cells_of("truth")] == [list(SCENES)]
    assert [cell.arguments["other"] for cell in cells_of("screenshots")] == ["b/plant.splat", "a/plant.splat"]
    assert [cells_of(name, SCENES[:1])[0].arguments["other"] for name in ("screenshots", "suite")] == [
        None,
        "spare.splat",
    ]


def test_settings_are_chosen_among_those_there_are() -> None:
    assert [cell.arguments["setting"] for cell in cells_of("finetune", SCENES[:1], "clean")] == ["clean"]
    assert len(cells_of("variants", SCENES[:1])) == 4
    with pytest.raises(InputError, match="Table 4 has no setting 'clean'"):
        cells_of("variants", SCENES, "clean")
