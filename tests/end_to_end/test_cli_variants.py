"""Clips that move, models in codebooks and tags through the commands: nothing is lost on the way in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.flows.records.opened_record import open_record
from engine.formats import encode_model, read_model, write_model
from engine.lab.sim.variants.codebooks import make_codebook
from engine.lab.sim.variants.synthetic import fit_spacetime, set_in_motion
from engine.model import GaussianModel
from engine.scenes.clip_marking import visible
from engine.scenes.codebook_files import read_codebook, write_codebook
from engine.scenes.spacetime_ply import read_spacetime_ply, write_spacetime_ply
from engine.watermark.keys import OwnerKey
from tests.end_to_end.conftest import SCENE, ask
from tests.formats.models import names_of, ply_of, rows_for

Capsys = pytest.CaptureFixture[str]
QUICK = ("--profile", "fast", "--set", "views=4", "--set", "view_size=256", "--set", "landmark_views=0")


def thin(every: int = 12) -> GaussianModel:
    """Every so many-th Gaussian of the plant, wider, so that it still covers the plant."""
    model = read_model(SCENE).model
    few = model.take(np.arange(0, len(model), every))
    return few.with_(log_scales=few.log_scales + np.float32(0.6))


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clip") / "clip.ply"
    moving = fit_spacetime(set_in_motion(thin(), swing=0.08, transient=0.3, seed=1))
    path.write_bytes(b"".join(write_spacetime_ply(moving)))
    return path


def embed(capsys: Capsys, key: Path, source: Path, out: Path, *more: str) -> tuple[int, dict[str, Any]]:
    record = out.with_suffix(".record")
    return ask(capsys, "embed", source, out, "--key", key, "--record", record, *QUICK, *more)


def verdict(capsys: Capsys, key: Path, record: Path, suspect: Path, *more: str | Path) -> dict[str, Any]:
    code, said = ask(capsys, "verify", suspect, "--key", key, "--record", record, *more)
    assert code in (0, 3, 4)
    return said


@pytest.mark.long
def test_a_clip_is_marked_as_a_clip(clip: Path, key: Path, tmp_path: Path, capsys: Capsys) -> None:
    out, record = tmp_path / "marked.ply", tmp_path / "marked.record"
    code, report = embed(capsys, key, clip, out)
    assert (code, report["format_in"], report["format_out"]) == (0, "spacetime", "spacetime")
    before, after = (read_spacetime_ply(path.read_bytes(), file="x")[0] for path in (clip, out))
    for name in ("trbf_center", "trbf_scale", "motion", "omega", "quats", "opacity_logits"):
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name), err_msg=name)
    assert verdict(capsys, key, record, out)["verdict"] == "marked"
    assert verdict(capsys, key, record, clip)["verdict"] == "not_marked"

    moment = tmp_path / "moment.ply"
    write_model(visible(after.at(0.9)), moment)
    assert "--original" in str(verdict(capsys, key, record, clip)["notes"])
    found = verdict(capsys, key, record, moment, "--original", clip)
    assert (found["verdict"], found["bit_accuracy"]) == ("marked", 1.0)
    write_model(visible(before.at(0.9)), moment)
    assert verdict(capsys, key, record, moment, "--original", clip)["verdict"] != "marked"
    code, said = ask(capsys, "verify", moment, "--key", key, "--record", record, "--original", SCENE)
    assert code == 2
    assert "is no clip that moves" in said["error"]["message"]


@pytest.mark.parametrize("name", ["marked.spz", "marked.splat"])
def test_a_format_without_motion_is_refused_for_a_clip(
    clip: Path, key: Path, tmp_path: Path, capsys: Capsys, name: str
) -> None:
    code, said = embed(capsys, key, clip, tmp_path / name)
    assert code == 2
    assert all(lost in said["error"]["message"] for lost in ("trbf_center", "motion_0", "omega_0", ".ply"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["owner.key"]
    code, said = embed(capsys, key, clip, tmp_path / "marked.ply", "--profile", "auto", "--survive", "worst")
    assert (code, "is not rehearsed" in said["error"]["message"]) == (2, True)


@pytest.mark.parametrize("moving", [["t", "scale_t", "rot_r_0"], ["vx", "vy", "vz", "time", "duration"], ["motion_0"]])
def test_gaussians_that_move_otherwise_are_refused_by_name(
    moving: list[str], key: Path, tmp_path: Path, capsys: Capsys
) -> None:
    names = [*names_of(1), *moving]
    (tmp_path / "four.ply").write_bytes(ply_of(names, rows_for(names, 50)))
    for command in (
        lambda: embed(capsys, key, tmp_path / "four.ply", tmp_path / "out.ply"),
        lambda: ask(capsys, "inspect", tmp_path / "four.ply"),
    ):
        code, said = command()
        assert code == 2
        assert all(repr(name) in said["error"]["message"] for name in moving)
    assert not (tmp_path / "out.ply").exists()


@pytest.mark.long
def test_frames_of_a_scene_that_moves(clip: Path, key: Path, tmp_path: Path, capsys: Capsys) -> None:
    """A `.ply` a moment, as 4DGS exports what its network deforms: marked together, verified together and alone."""
    moving = read_spacetime_ply(clip.read_bytes(), file="x")[0]
    source, out = tmp_path / "frames", tmp_path / "marked"
    source.mkdir()
    for k, time in enumerate((0.1, 0.5, 0.9)):
        write_model(moving.at(time), source / f"time_{k:05d}.ply")
    code, report = embed(capsys, key, source, out)
    assert (code, report["format_in"], report["format_out"]) == (0, "frames", "frames")
    names = [f"time_{k:05d}.ply" for k in range(3)]
    assert sorted(path.name for path in out.iterdir()) == names
    record = tmp_path / "marked.record"
    assert verdict(capsys, key, record, out)["verdict"] == "marked"
    assert verdict(capsys, key, record, source)["verdict"] == "not_marked"
    found = verdict(capsys, key, record, out / names[2], "--original", source)
    assert (found["verdict"], found["bit_accuracy"]) == ("marked", 1.0)
    code, said = ask(capsys, "convert", source, tmp_path / "one.spz")
    assert (code, "frames is written as frames" in said["error"]["message"]) == (2, True)


def test_a_network_beside_the_file_is_spoken_of(key: Path, tmp_path: Path, capsys: Capsys) -> None:
    write_model(thin(24), tmp_path / "point_cloud.ply")
    assert ask(capsys, "inspect", tmp_path / "point_cloud.ply")[1]["repairs"] == []
    (tmp_path / "deformation.pth").write_bytes(b"")
    repairs = ask(capsys, "inspect", tmp_path / "point_cloud.ply")[1]["repairs"]
    assert [repair["code"] for repair in repairs] == ["deformation_beside"]


@pytest.mark.long
def test_codebooks_are_marked_in_their_folder(key: Path, tmp_path: Path, capsys: Capsys) -> None:
    source, out = tmp_path / "compressed", tmp_path / "marked"
    write_codebook(make_codebook(thin(6), {"dc": 1024, "rot": 256}), source)
    code, report = embed(capsys, key, source, out)
    assert (code, report["format_in"], report["format_out"]) == (0, "codebook", "codebook")
    assert report["bytes_out"] == pytest.approx(report["bytes_in"], rel=0.01)
    before, after = read_codebook(source), read_codebook(out)
    assert before.centers.keys() == after.centers.keys()
    np.testing.assert_array_equal(before.indices["dc"], after.indices["dc"])
    found = verdict(capsys, key, tmp_path / "marked.record", out)
    assert (found["verdict"], found["bit_accuracy"]) == ("marked", 1.0)
    assert verdict(capsys, key, tmp_path / "marked.record", source)["verdict"] == "not_marked"
    code, said = embed(capsys, key, source, out, "--force")
    assert (code, "new folder" in said["error"]["message"]) == (2, True)
    lone = tmp_path / "lone.ply"
    lone.write_bytes((source / "point_cloud.ply").read_bytes())
    code, said = ask(capsys, "inspect", lone)
    assert (code, "give the folder" in said["error"]["message"]) == (2, True)


@pytest.mark.parametrize("kind", ["ply", "compressed.ply", "spz", "sog"])
def test_the_tag_of_antialiased_models_goes_all_the_way(kind: str, key: Path, tmp_path: Path, capsys: Capsys) -> None:
    source, out = tmp_path / f"source.{kind}", tmp_path / f"marked.{kind}"
    source.write_bytes(encode_model(replace(thin(24), antialiased=True), kind))
    code, report = embed(capsys, key, source, out)
    assert code == 0
    assert not any("antialiased" in note for note in report["notes"])
    assert read_model(out).model.antialiased
    record = open_record(out.with_suffix(".record").read_bytes(), OwnerKey.read(key))
    assert record.reference.antialiased
    assert verdict(capsys, key, out.with_suffix(".record"), out)["verdict"] == "marked"
    code, said = ask(capsys, "inspect", out)
    assert (code, said["render_mode"]) == (0, "antialiased")
