"""The main job through the commands: mark, steal, verify; every exit code and every promised key."""

from __future__ import annotations

import stat
import subprocess
import sys
from pathlib import Path

import pytest

from engine.formats.image_files import read_picture
from tests.end_to_end.conftest import SCENE, Marked

EMBED_KEYS = {
    "gaussians_in",
    "gaussians_out",
    "bits",
    "message",
    "psnr_worst_view",
    "ssim_worst_view",
    "psnr_total_worst_view",
    "capacity_bits",
    "bytes_out",
    "seconds",
    "seconds_by_stage",
    "repairs",
}
VERIFY_KEYS = {
    "verdict",
    "confidence",
    "log10_false_claim",
    "z",
    "bits",
    "registered_bits",
    "matching",
    "bit_accuracy",
    "reliability",
    "strength",
    "derived",
    "derived_fraction",
    "derivation",
    "rate_basis",
    "would_be_claim_if_attested",
    "attested",
    "transform",
    "route",
    "copy",
    "seconds",
    "seconds_by_stage",
}

Capsys = pytest.CaptureFixture[str]


def test_embed_reports_what_it_promised(marked: Marked) -> None:
    report = marked.report
    assert report.keys() >= EMBED_KEYS
    assert (report["message"], report["bits"], report["copy"]) == ("c0ffee42", 32, "acme")
    assert report["gaussians_in"] == report["gaussians_out"] == 37_883
    assert report["psnr_worst_view"] >= 47.0
    assert report["ssim_worst_view"] >= 0.998
    assert report["bytes_out"] == marked.model.stat().st_size
    assert {"read", "write"} <= report["seconds_by_stage"].keys()
    assert sum(report["seconds_by_stage"].values()) <= report["seconds"]


def test_the_record_is_for_the_owner_alone(marked: Marked) -> None:
    assert stat.S_IMODE(marked.record.stat().st_mode) == 0o600
    assert stat.S_IMODE(marked.key.stat().st_mode) == 0o600


def test_marked_is_exit_code_0(marked: Marked, capsys: Capsys) -> None:
    code, claim = marked.verify(capsys, marked.model)
    assert code == 0
    assert claim.keys() >= VERIFY_KEYS
    assert (claim["verdict"], claim["bits"]["hex"], claim["bit_accuracy"]) == ("marked", "c0ffee42", 1.0)
    assert (claim["route"], claim["copy"]) == ("model", "acme")
    assert len(claim["reliability"]) == 32
    assert claim["log10_false_claim"] < -38.6
    assert claim["derived_fraction"] > 0.95


def test_unmarked_is_exit_code_3(marked: Marked, capsys: Capsys) -> None:
    code, claim = marked.verify(capsys, marked.scene)
    assert (code, claim["verdict"], claim["derived"]) == (3, "not_marked", True)


def test_too_little_is_exit_code_4(marked: Marked, capsys: Capsys, tmp_path: Path) -> None:
    """A screenshot that shows nothing of the scene decides nothing."""
    from PIL import Image

    Image.new("RGB", (320, 240), (90, 120, 60)).save(tmp_path / "plain.png")
    code, claim = marked.verify(capsys, tmp_path / "plain.png")
    assert (code, claim["verdict"]) == (4, "inconclusive")
    assert claim["notes"]


def test_the_claim_in_words(marked: Marked, capsys: Capsys) -> None:
    from engine.cli.app import run

    capsys.readouterr()
    args = ["verify", str(marked.model), "--record", str(marked.record), "--key", str(marked.key)]
    assert run(args) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "Watermark found." in text
    assert "below 10^-300" in text
    assert "It does not say" in text


def test_a_wrong_key_is_told_as_such(marked: Marked, capsys: Capsys, tmp_path: Path) -> None:
    assert marked.ask(capsys, "keygen", tmp_path / "other.key")[0] == 0
    code, said = marked.ask(capsys, "verify", marked.model, "--record", marked.record, "--key", tmp_path / "other.key")
    assert code == 2
    assert said["error"]["type"] == "WrongKeyError"
    assert "this key did not make this record" in said["error"]["message"]


VERIFYING = """
import sys
from engine.cli.app import run
assert run(["verify", sys.argv[1], "--key", sys.argv[2], "--record", sys.argv[3], "--json"]) == 0
print(sorted({"numba", "scipy.spatial", "scipy.special", "scipy.sparse", "scipy.fft", "torch"} & set(sys.modules)))
"""


def test_usual_suspects_are_verified_without_slow_imports(marked: Marked, capsys: Capsys, tmp_path: Path) -> None:
    """Each of these packages costs a tenth to a third of a second, of three that a claim takes."""
    moved, picture = tmp_path / "moved.ply", tmp_path / "picture.png"
    assert marked.ask(capsys, "attack", "similarity", marked.model, moved, "--strength", "4")[0] == 0
    assert marked.ask(capsys, "render", marked.model, picture)[0] == 0
    drawn = read_picture(picture)
    assert max(drawn[0].max(), drawn[-1].max()) < 0.1, "the plant is cut off above or below"
    for suspect in (moved, picture):
        command = [sys.executable, "-c", VERIFYING, str(suspect), str(marked.key), str(marked.record)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.stdout.splitlines()[-1] == "[]", done.stdout + done.stderr


@pytest.mark.parametrize(
    ("chain", "ending"),
    [
        ([("similarity", "4"), ("shuffle", "1")], ".ply"),
        ([("crop", "0.25")], ".spz"),
        ([("prune_random", "0.5"), ("noise_colors", "0.05")], ".splat"),
    ],
    ids=["moved", "cropped", "thinned"],
)
def test_stolen_models_are_claimed(
    marked: Marked, capsys: Capsys, tmp_path: Path, chain: list[tuple[str, str]], ending: str
) -> None:
    suspect = marked.model
    for step, (name, strength) in enumerate(chain):
        target = tmp_path / f"{step}{ending}"
        code, report = marked.ask(capsys, "attack", name, suspect, target, "--strength", strength, "--seed", "3")
        assert code == 0
        assert report["bytes_out"] == target.stat().st_size
        suspect = target
    code, claim = marked.verify(capsys, suspect)
    assert (code, claim["bit_accuracy"]) == (0, 1.0)


def test_a_picture_from_a_known_camera_is_claimed(marked: Marked, capsys: Capsys, tmp_path: Path) -> None:
    shot, camera, jpeg = tmp_path / "shot.png", tmp_path / "camera.json", tmp_path / "shot.jpg"
    code, report = marked.ask(
        capsys, "render", marked.model, shot, "--view", "4", "--size", "640", "480", "--save-camera", camera
    )
    assert (code, report["width"], report["height"]) == (0, 640, 480)
    assert marked.ask(capsys, "attack", "jpeg", shot, jpeg, "--strength", "50")[0] == 0
    code, claim = marked.verify(capsys, jpeg, "--cameras", camera)
    assert (code, claim["route"], claim["bit_accuracy"]) == (0, "image", 1.0)


def test_the_same_command_gives_the_same_attack(marked: Marked, capsys: Capsys, tmp_path: Path) -> None:
    for name in ("a.splat", "b.splat"):
        marked.ask(capsys, "attack", "noise_all", marked.model, tmp_path / name, "--seed", "5")
    assert (tmp_path / "a.splat").read_bytes() == (tmp_path / "b.splat").read_bytes()


def test_inspect(marked: Marked, capsys: Capsys) -> None:
    code, report = marked.ask(capsys, "inspect", SCENE)
    assert (code, report["gaussians"], report["sh_degree"], report["format"]) == (0, 113_648, 0, "splat")
    assert len(report["sha256"]) == 64
