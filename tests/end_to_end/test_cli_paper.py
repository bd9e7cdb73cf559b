"""The paper's system through the commands: marked, read by its own decoder and by ours, drawn by its own rule."""

from __future__ import annotations

from pathlib import Path

import pytest

from engine.formats.image_files import read_picture
from tests.end_to_end.conftest import ask
from tests.scenes import sparse_plant

Capsys = pytest.CaptureFixture[str]
KNOBS = ("refine.steps=2", "views=3", "view_size=256", "landmark_views=0", "prune.recover=false")
SMALL = [part for knob in KNOBS for part in ("--set", knob)]


def test_every_bit_is_read_by_the_papers_decoder(capsys: Capsys, tmp_path: Path) -> None:
    scene, key, model, record = (tmp_path / name for name in ("plant.splat", "owner.key", "marked.ply", "my.record"))
    scene.write_bytes(sparse_plant())
    assert ask(capsys, "keygen", key)[0] == 0
    code, said = ask(capsys, "embed", scene, model, "--key", key, "--record", record, "--profile", "paper", *SMALL)
    assert code == 0
    assert said["gaussians_out"] < 0.45 * said["gaussians_in"]
    assert said["densified"] > 0
    for decoder in ("paper", "ours"):
        code, claim = ask(capsys, "verify", model, "--record", record, "--key", key, "--decoder", decoder)
        assert (code, claim["verdict"], claim["matching"], len(claim["reliability"])) == (0, "marked", 32, 32)
        assert claim["bits"]["hex"] == said["message"]
    assert ask(capsys, "verify", scene, "--record", record, "--key", key)[0] in (3, 4), "the unmarked original"


@pytest.mark.long
def test_a_picture_is_drawn_with_an_early_stop(capsys: Capsys, tmp_path: Path) -> None:
    scene = tmp_path / "plant.splat"
    scene.write_bytes(sparse_plant())
    pictures = {}
    for name, options in {"whole": (), "late": ("--early-stop", "1000000"), "early": ("--early-stop", "0.95")}.items():
        out = tmp_path / f"{name}.png"
        assert ask(capsys, "render", scene, out, "--size", "128", "96", *options)[0] == 0
        pictures[name] = read_picture(out)
    assert (pictures["late"] == pictures["whole"]).all()
    assert (pictures["early"] != pictures["whole"]).any()
    code, said = ask(capsys, "render", scene, tmp_path / "no.png", "--early-stop", "0")
    assert code == 2
    assert "tau of the early stop is 0" in said["error"]["message"]
