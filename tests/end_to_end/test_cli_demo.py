"""The demo does what it says it does."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.end_to_end.conftest import ask


@pytest.mark.long
def test_demo(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "demo-out"
    code, report = ask(capsys, "demo", "--out", out)
    assert code == 0
    assert report["as_expected"] is True
    verdicts = {name: outcome["verdict"] for name, outcome in report["outcomes"].items()}
    assert verdicts == {
        "moved": "marked",
        "piece": "marked",
        "screenshot": "marked",
        "unmarked": "not_marked",
        "another key": "wrong_key",
    }
    assert report["outcomes"]["screenshot"]["route"] == "image"
    assert 0.2 < report["outcomes"]["piece"]["derived_fraction"] < 0.3
    made = {path.name for path in out.iterdir()}
    assert made == {
        "owner.key",
        "scene.record",
        "marked.ply",
        "stolen-moved.ply",
        "stolen-piece.spz",
        "stolen-screenshot.jpg",
        "demo.png",
    }
    with Image.open(report["picture"]) as picture:
        assert picture.width == pytest.approx(1200, abs=20)
        assert picture.height > 800  # as long as the claim: its last line is whole, with paper below
        assert np.asarray(picture.convert("L"))[-20:].min() > 250


def test_demo_without_its_scene_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("engine.lab.cli.shared.DEMO_SCENE", "gone.splat")
    code, said = ask(capsys, "demo", "--out", tmp_path / "demo-out")
    assert code == 2
    assert "gone.splat" in said["error"]["message"]
    assert not (tmp_path / "demo-out").exists()
