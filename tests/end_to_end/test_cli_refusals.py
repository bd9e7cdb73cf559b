"""What the commands refuse, before and after work was done; and that nothing half-written stays."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.end_to_end.conftest import DATA, SCENE, Marked, ask
from tests.scenes import sparse_plant

Capsys = pytest.CaptureFixture[str]
SMALL = DATA / "train_1000.ply"


def refused(capsys: Capsys, *arguments: str | Path) -> dict[str, object]:
    """The error of a command that must end with exit code 2."""
    code, said = ask(capsys, *arguments)
    assert code == 2
    return dict(said["error"])


def test_a_record_is_not_replaced_without_force(marked: Marked, capsys: Capsys, tmp_path: Path) -> None:
    before = marked.record.read_bytes()
    error = refused(capsys, "embed", SCENE, tmp_path / "out.ply", "--key", marked.key, "--record", marked.record)
    assert "--force" in str(error["message"])
    assert marked.record.read_bytes() == before
    assert not (tmp_path / "out.ply").exists()


def test_interrupted_at_the_last_moment(
    key: Path, capsys: Capsys, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The model is written beside its place, the record is not yet: nothing of either stays."""

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    thin = tmp_path / "thin.ply"
    assert ask(capsys, "attack", "prune_random", SCENE, thin, "--strength", "0.85")[0] == 0
    monkeypatch.setattr("engine.usecases.mark.write_secret", interrupted)
    out, record = tmp_path / "out" / "m.splat", tmp_path / "out" / "m.record"
    out.parent.mkdir()
    code, said = ask(
        capsys,
        "embed",
        thin,
        out,
        "--key",
        key,
        "--record",
        record,
        "--bits",
        "16",
        "--profile",
        "fast",
        "--set",
        "landmark_views=0",
        "--psnr",
        "40",
    )
    assert (code, said["error"]["type"]) == (130, "Interrupted")
    assert list(out.parent.iterdir()) == []


def test_ctrl_c_in_the_middle(key: Path, tmp_path: Path) -> None:
    out, scene = tmp_path / "out", tmp_path / "plant.splat"
    out.mkdir()
    scene.write_bytes(sparse_plant())
    arguments = ["embed", scene, out / "m.ply", "--key", key, "--record", out / "m.record", "--profile", "fast"]
    # A shell that starts the tests in the background hands on SIGINT as ignored, and Python leaves it so.
    program = """
import signal, sys
from engine.cli.app import main
signal.signal(signal.SIGINT, signal.default_int_handler)
from engine.flows.embed import planning_basis as groundwork
quantize = groundwork.quantize
def announced(*given, **named):
    sys.stderr.write("in the middle\\n")
    return quantize(*given, **named)
groundwork.quantize = announced
main()
"""
    with subprocess.Popen(
        [sys.executable, "-c", program, *map(str, arguments)], stderr=subprocess.PIPE, text=True
    ) as running:
        assert running.stderr is not None
        assert any(line == "in the middle\n" for line in running.stderr)
        running.send_signal(signal.SIGINT)
        said = running.stderr.read()
    assert running.returncode == 130
    assert "interrupted; nothing was written" in said
    assert "Traceback" not in said
    assert list(out.iterdir()) == []


def test_a_message_the_scene_cannot_carry(key: Path, capsys: Capsys, tmp_path: Path) -> None:
    error = refused(
        capsys,
        "embed",
        SMALL,
        tmp_path / "m.ply",
        "--key",
        key,
        "--record",
        tmp_path / "r",
        "--bits",
        "256",
        "--profile",
        "fast",
        "--psnr",
        "60",
    )
    assert error["type"] == "CapacityError"
    assert error["wanted"] == 256
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize(
    ("options", "part"),
    [
        (["--message", "xyz"], "hexadecimal"),
        (["--message", "c0ffee42", "--bits", "32"], "not both"),
        (["--bits", "20"], "whole bytes"),
        (["--profile", "heroic"], "heroic"),
        (["--budget", "lots"], "lots"),
        (["--psnr", "5"], "psnr"),
        (["--output", "tiny"], "tiny"),
        (["--cameras", "none.json"], "none.json"),
    ],
    ids=lambda value: value[0].strip("-") if isinstance(value, list) else "",
)
def test_options_of_embed(key: Path, capsys: Capsys, tmp_path: Path, options: list[str], part: str) -> None:
    error = refused(capsys, "embed", SMALL, tmp_path / "m.ply", "--key", key, "--record", tmp_path / "r", *options)
    assert part in str(error["message"])


def test_outputs_need_a_known_ending_and_another_name(key: Path, capsys: Capsys, tmp_path: Path) -> None:
    copy = tmp_path / "own.ply"
    copy.write_bytes(SMALL.read_bytes())
    common = ["--key", key, "--record", tmp_path / "r"]
    assert ".sog" in str(refused(capsys, "embed", SMALL, tmp_path / "m.xyz", *common)["message"])
    assert "input itself" in str(refused(capsys, "embed", copy, copy, *common)["message"])
    assert "no folder" in str(refused(capsys, "embed", copy, tmp_path / "no" / "m.ply", *common)["message"])
    assert copy.read_bytes() == SMALL.read_bytes()


def test_broken_input_names_the_file(capsys: Capsys, tmp_path: Path) -> None:
    broken = tmp_path / "broken.ply"
    broken.write_bytes(SMALL.read_bytes()[:5000])
    error = refused(capsys, "inspect", broken)
    assert error["type"] == "FormatError"
    assert "broken.ply" in str(error["message"])
    assert "missing.ply" in str(refused(capsys, "inspect", tmp_path / "missing.ply")["message"])


def test_suspects_of_two_kinds(marked: Marked, capsys: Capsys, tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    common = ["--record", marked.record, "--key", marked.key]
    assert "not both" in str(refused(capsys, "verify", SCENE, tmp_path / "a.png", *common)["message"])
    assert "one model" in str(refused(capsys, "verify", SCENE, SMALL, *common)["message"])
    assert "a.png" in str(refused(capsys, "verify", tmp_path / "a.png", *common)["message"])
    assert "route" in str(refused(capsys, "verify", SCENE, "--route", "magic", *common)["message"])
    assert "route" in str(refused(capsys, "verify", SCENE, "--route", "image", *common)["message"])
    assert refused(capsys, "verify", SCENE, "--record", SMALL, "--key", marked.key)["type"] == ("MalformedRecordError")
    assert refused(capsys, "verify", SCENE, "--record", marked.record, "--key", SMALL)["type"] == ("KeyFileError")


def test_attacks(capsys: Capsys, tmp_path: Path) -> None:
    assert "jpeg" in str(refused(capsys, "attack", "melt", SMALL, tmp_path / "a.ply")["message"])
    assert "images" in str(refused(capsys, "attack", "jpeg", SMALL, tmp_path / "a.jpg")["message"])
    message = refused(capsys, "attack", "crop", SMALL, tmp_path / "a.ply", "--strength", "most")["message"]
    assert "kept share" in str(message)
    message = refused(capsys, "attack", "crop", SMALL, tmp_path / "a.ply", "--reading", "loud")["message"]
    assert "literal" in str(message)
    assert list(tmp_path.iterdir()) == []


def test_render_and_bench(capsys: Capsys, tmp_path: Path) -> None:
    assert "view" in str(refused(capsys, "render", SMALL, tmp_path / "a.png", "--view", "99")["message"])
    assert ".png" in str(refused(capsys, "render", SMALL, tmp_path / "a.gif")["message"])
    assert "flymark" in str(refused(capsys, "evaluate", "--suite", "everything")["message"])
    wrong = refused(capsys, "evaluate", "--suite", "null", "--method", "qim", "--out", tmp_path)["message"]
    assert "no option --method" in str(wrong)


def test_a_gpu_that_is_not_there(key: Path, capsys: Capsys, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Is missed before the model, which is not there either, is looked for."""
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    command = ("embed", tmp_path / "none.ply", tmp_path / "out.ply", "--key", key, "--record", tmp_path / "a.record")
    assert "device 'cuda'" in str(refused(capsys, *command, "--device", "cuda")["message"])
    assert "device 'cuda'" in str(refused(capsys, "evaluate", "--suite", "budgets", "--device", "cuda")["message"])
    assert "none.ply" in str(refused(capsys, *command, "--device", "auto")["message"])
    wrong = refused(capsys, "evaluate", "--suite", "null", "--device", "auto", "--out", tmp_path)["message"]
    assert "no option --device" in str(wrong)
    assert [path.name for path in tmp_path.iterdir()] == ["owner.key"]


def test_an_unknown_profile_has_no_settings(capsys: Capsys) -> None:
    assert "heroic" in str(refused(capsys, "config", "show", "--profile", "heroic")["message"])
    code, shown = ask(capsys, "config", "show", "--profile", "fast")
    assert code == 0
    assert shown["psnr_db"] == 47.0
