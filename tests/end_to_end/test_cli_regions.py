"""`verify --regions`: a folder with the map, the numbers and the rows."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from engine.cli.app import run
from engine.formats import read_model, write_model
from tests.end_to_end.conftest import Marked


def test_where_the_mark_is(marked: Marked, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, said = marked.verify(capsys, marked.model, "--regions", tmp_path / "where", "--false-discovery-rate", "0.05")
    assert code == 0
    output = json.loads((tmp_path / "where" / "regions.json").read_text())
    assert output["found"][0]["transform"]["scale"] == pytest.approx(1.0, rel=1e-3)
    assert said["regions"] == {name: output[name] for name in said["regions"] if name != "folder"} | {
        "folder": str(tmp_path / "where")
    }
    assert said["regions"]["false_discovery_rate"] == 0.05
    assert said["regions"]["marked"] == len(output["found"][0]["regions"]) > 50
    assert "locate" in said["seconds_by_stage"]
    with np.load(tmp_path / "where" / "regions.npz", allow_pickle=False) as rows:
        names = [str(name) for name in rows["states"]]
        assert (rows["state"] == names.index("marked")).all()
        assert len(rows["piece"]) == len(rows["region"]) == len(rows["asset_state"])
    assert Image.open(tmp_path / "where" / "regions.png").width > 1000


def test_regions_count_the_rows_of_the_file(marked: Marked, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rows that cannot be read stay rows: what stands behind them keeps its number."""
    model = read_model(marked.model).model
    bad = np.zeros(len(model) + 30, dtype=bool)
    bad[[*range(20), *range(500, 505), *range(len(bad) - 5, len(bad))]] = True
    suspect = model.take(np.maximum(np.cumsum(~bad) - 1, 0))
    means = suspect.means.copy()
    means[bad] = np.nan
    write_model(suspect.with_(means=means), tmp_path / "holes.ply")
    code, said = marked.verify(capsys, tmp_path / "holes.ply", "--regions", tmp_path / "where")
    assert (code, said["repairs"][0]["count"]) == (0, 30)
    with np.load(tmp_path / "where" / "regions.npz", allow_pickle=False) as rows:
        np.testing.assert_array_equal(rows["piece"] == -1, bad)
        np.testing.assert_array_equal(rows["state"] == 0, bad)


def test_a_folder_that_is_not_new_is_refused_before_any_work(
    marked: Marked, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "mine").write_text("x")
    usual = ("--record", str(marked.record), "--key", str(marked.key))
    unread = ("--record", str(tmp_path / "gone.record"), "--key", str(marked.key))
    assert run(["verify", str(marked.model), *unread, "--regions", str(tmp_path / "old")]) == 2
    assert "new folder" in capsys.readouterr().err
    assert run(["verify", str(marked.model), *usual, "--regions", str(tmp_path / "x"), "--original", "y"]) == 2
    assert "--original" in capsys.readouterr().err
