"""`mark3dgs convert`: every format out, streamed SOG with levels, and what is refused before anything is written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from engine.formats import FORMATS, read_model, write_model
from engine.lab.sim.variants.codebooks import make_codebook
from engine.scenes.codebook_files import write_codebook
from tests.end_to_end.conftest import DATA, Marked, ask
from tests.formats.ksplat_files import ksplat_of, section_of
from tests.formats.models import random_model

Capsys = pytest.CaptureFixture[str]
SMALL = DATA / "train_1000.ply"


@pytest.mark.parametrize("kind", FORMATS)
def test_into_every_format(kind: str, tmp_path: Path, capsys: Capsys) -> None:
    out = tmp_path / f"scene.{kind}"
    code, report = ask(capsys, "convert", SMALL, out)
    assert (code, report["format_out"], report["gaussians"]) == (0, kind, 1000)
    assert report["bytes_out"] == out.stat().st_size
    assert read_model(out).format == kind


def test_ksplat_comes_in(tmp_path: Path, capsys: Capsys) -> None:
    (tmp_path / "old.ksplat").write_bytes(ksplat_of(section_of(random_model(1, 300), 1), count=300, level=1))
    code, report = ask(capsys, "convert", tmp_path / "old.ksplat", tmp_path / "new.ply")
    assert (code, report["format_in"]) == (0, "ksplat")
    assert len(read_model(tmp_path / "new.ply").model) == 300


def test_a_marked_scene_is_published_in_levels_and_verified(marked: Marked, tmp_path: Path, capsys: Capsys) -> None:
    whole = read_model(marked.model).model
    few = tmp_path / "few.ply"
    write_model(whole.take(np.arange(0, len(whole), 5)), few)
    out = tmp_path / "published" / "lod-meta.json"
    code, report = ask(capsys, "convert", few, out, "--levels", "2")
    first, second = report["levels"]
    assert (code, report["format_out"]) == (0, "lod-meta.json")
    assert second == pytest.approx(first / 4, rel=0.01)
    code, found = marked.verify(capsys, out.parent)
    assert (code, found["verdict"]) == (0, "marked")
    assert [repair["count"] for repair in found["repairs"] if repair["code"] == "levels_left_out"] == [second]
    code, said = ask(capsys, "convert", few, out)
    assert (code, "new folder" in said["error"]["message"]) == (2, True)


def test_what_is_lost_is_said(tmp_path: Path, capsys: Capsys) -> None:
    write_model(replace(random_model(1, 50), antialiased=True), tmp_path / "mip.ply")
    code, report = ask(capsys, "convert", tmp_path / "mip.ply", tmp_path / "mip.glb")
    assert code == 0
    assert "SplatRenderMode: mip" in report["notes"][0]


def test_codebooks_are_looked_up(tmp_path: Path, capsys: Capsys) -> None:
    compressed = make_codebook(random_model(1, 200), {"dc": 16})
    write_codebook(compressed, tmp_path / "compressed")
    code, report = ask(capsys, "convert", tmp_path / "compressed", tmp_path / "plain.ply")
    assert (code, report["format_in"], report["format_out"]) == (0, "codebook", "ply")
    np.testing.assert_array_equal(read_model(tmp_path / "plain.ply").model.sh, compressed.decode().sh)


@pytest.mark.parametrize(
    ("name", "more", "what"),
    [
        ("scene.ksplat", (), "the name ends in none of"),
        ("scene.ply", ("--levels", "2"), "lod-meta.json"),
        ("absent/scene.ply", (), "there is no folder"),
    ],
)
def test_refusals(name: str, more: tuple[str, ...], what: str, tmp_path: Path, capsys: Capsys) -> None:
    code, said = ask(capsys, "convert", SMALL, tmp_path / name, *more)
    assert (code, what in said["error"]["message"]) == (2, True)
    assert list(tmp_path.iterdir()) == []
