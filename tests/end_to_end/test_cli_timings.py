"""Benchmarks measure, and say on what."""

import json
from pathlib import Path

import pytest

from engine.lab.evaluate.bench.timing import spread, stage_medians
from tests.end_to_end.conftest import SCENE, ask


def test_medians_and_extremes() -> None:
    assert spread([3.0, 1.0, 2.0]) == {"seconds": 2.0, "seconds_least": 1.0, "seconds_most": 3.0}
    runs = [{"look": 1.0, "plan": 5.0}, {"look": 2.0, "plan": 4.0}, {"look": 9.0, "plan": 6.0}]
    assert stage_medians(runs) == {"look": 2.0, "plan": 5.0}


@pytest.mark.long
@pytest.mark.parametrize("what", ["embed", "verify"])
def test_bench(what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    thin, out = tmp_path / "thin.splat", tmp_path / "out"
    assert ask(capsys, "attack", "prune_random", SCENE, thin, "--strength", "0.5")[0] == 0
    code, report = ask(capsys, "evaluate", "--suite", what, "--scene", thin, "--repeats", "1", "--out", out)
    assert code == 0
    stored = json.loads((out / "results.json").read_text())["rows"]
    assert [{name: row[name] for name in row if name != "cell"} for row in stored] == report["rows"]
    assert report["machine"]["cores"] >= 1
    suspects = ["model", "picture", "screenshot"] if what == "verify" else [None]
    assert [row.get("suspect") for row in report["rows"]] == suspects
    for row in report["rows"]:
        assert 0 < row["seconds_least"] <= row["seconds"] <= row["seconds_most"]
        assert sum(row["seconds_by_stage"].values()) <= row["seconds"]
        assert row["peak_memory_mb"] > 50
        assert row.get("verdict", "marked") == "marked"
