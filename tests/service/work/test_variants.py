"""Uploads that are no plain model: a clip is marked as a clip, old formats come back in one that is written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.errors import UnsupportedFormatError
from engine.formats import read_model
from engine.lab.sim.variants.synthetic import fit_spacetime, set_in_motion
from engine.scenes.spacetime_ply import read_spacetime_ply, write_spacetime_ply
from service.work.embedding import embed_mark
from service.work.tasks import TASKS
from tests.formats.ksplat_files import ksplat_of, section_of
from tests.scenes import sparse_plant
from tests.service.work.conftest import KEY, silent
from tests.service.work.test_tasks import EMBED


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clip") / "clip.ply"
    moving = fit_spacetime(set_in_motion(read_model(sparse_plant()).model, swing=0.08, transient=0.3, seed=1))
    path.write_bytes(b"".join(write_spacetime_ply(moving)))
    return path


def test_a_clip_is_marked_and_verified_as_a_clip(clip: Path, tmp_path: Path) -> None:
    reply = embed_mark(EMBED | {"model": str(clip)}, tmp_path, silent)
    assert (reply["format"], reply["original_format"]) == ("ply", "spacetime")
    before, after = (
        read_spacetime_ply(path.read_bytes(), file="x")[0] for path in (clip, tmp_path / reply["files"]["model"])
    )
    for name in ("trbf_center", "trbf_scale", "motion", "omega"):
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name))
    candidate = {"asset": "clip", "original": "clip", "record": str(tmp_path / reply["files"]["record"]), "key": KEY}
    request: dict[str, Any] = {"candidates": [candidate], "false_claim_rate": 1e-9, "spz_frame": "auto"}
    for suspect, verdict in ((tmp_path / reply["files"]["model"], "marked"), (clip, "not_marked")):
        found = TASKS["verify"](request | {"model": str(suspect)}, tmp_path, silent)
        assert (found["claim"]["verdict"], found["subject"]["format"]) == (verdict, "spacetime")


def test_a_clip_stays_one(clip: Path, tmp_path: Path) -> None:
    with pytest.raises(UnsupportedFormatError, match="motion_0"):
        embed_mark(EMBED | {"model": str(clip), "format": "spz"}, tmp_path, silent)
    with pytest.raises(UnsupportedFormatError, match="motion_0"):
        TASKS["convert"]({"model": str(clip), "format": "glb"}, tmp_path, silent)
    assert list(tmp_path.iterdir()) == []
    assert TASKS["inspect"]({"model": str(clip)}, tmp_path, silent)["format"] == "spacetime"


def test_a_format_that_is_only_read_comes_back_as_ply(tmp_path: Path) -> None:
    model = read_model(sparse_plant()).model
    few = model.take(np.arange(0, len(model), 4))
    old = tmp_path / "old"
    old.write_bytes(ksplat_of(section_of(few, 1), count=len(few), level=1))
    reply = embed_mark(EMBED | {"model": str(old)}, tmp_path, silent)
    assert (reply["format"], reply["original_format"], reply["files"]["model"]) == ("ply", "ksplat", "model.ply")
    assert read_model(tmp_path / "model.ply").format == "ply"
