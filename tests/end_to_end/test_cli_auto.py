"""`embed --profile auto` through the command line: it says what it chose, and keeps what was requested."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from engine.formats import encode_model, read_model
from tests.end_to_end.conftest import SCENE, Marked


def test_auto_says_what_it_chose_and_verifies(
    marked: Marked, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    thin = tmp_path / "thin.ply"
    thin.write_bytes(encode_model(read_model(SCENE).model.take(np.arange(0, 113_000, 4)), "ply"))
    record, model = tmp_path / "thin.record", tmp_path / "marked.ply"
    code, said = marked.ask(
        capsys,
        "embed",
        thin,
        model,
        "--key",
        marked.key,
        "--record",
        record,
        "--profile",
        "auto",
        "--psnr",
        "44",
        "--bits",
        "16",
        "--set",
        "landmark_views=0",
    )
    assert code == 0
    choice = said["choice"]
    assert choice["psnr_db"] == 44.0
    assert choice["met"] == (choice["predicted_z"] >= choice["wanted_z"])
    assert said["seconds_by_stage"]["choose"] > 0
    assert choice["saved_bytes"] == 0
    assert abs(choice["saved_seconds"]) < 10 * said["seconds"], "an estimate, of the size of what it is of"
    assert said["psnr_worst_view"] >= 44.0
    code, claim = marked.ask(capsys, "verify", model, "--record", record, "--key", marked.key)
    assert code == 0
    assert claim["bit_accuracy"] == 1.0


def test_named_profiles_choose_nothing(marked: Marked) -> None:
    assert marked.report["choice"] is None
