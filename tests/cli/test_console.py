"""Results on stdout for people or for machines, never both."""

import json

import numpy as np
import pytest

from engine.cli.console import Console
from engine.numerics.plain import plain


def test_plain_values_are_json() -> None:
    value = {"a": np.float32(1.5), "b": np.arange(3), "c": (1, None, True), "d": float("inf"), "e": np.int64(7)}
    assert json.loads(json.dumps(plain(value), allow_nan=False)) == {
        "a": 1.5,
        "b": [0, 1, 2],
        "c": [1, None, True],
        "d": None,
        "e": 7,
    }


def test_people_and_machines(capsys: pytest.CaptureFixture[str]) -> None:
    for machine in (False, True):
        console = Console(machine)
        console.say("text")
        console.note("beside")
        console.emit({"n": 1})
        captured = capsys.readouterr()
        if machine:
            assert (json.loads(captured.out), captured.err) == ({"n": 1}, "")
        else:
            assert (captured.out, captured.err) == ("text\n", "beside\n")


def test_a_files_name_is_no_command_to_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    console = Console(False)
    console.say("\x1b[31mscene\x07.ply: ply, für 日本\t1")
    console.note("\x9b2Jscene.ply")
    assert capsys.readouterr() == ("\\x1b[31mscene\\x07.ply: ply, für 日本\t1\n", "\\x9b2Jscene.ply\n")


def test_long_stages_leave_a_line_where_there_is_no_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("engine.cli.console.LONG_STAGE_SECONDS", 0.0)
    with Console(False).progress() as progress:
        progress("plan", 0.0)
        progress("plan", 1.0)
        progress("refine", 0.0)
        progress("refine: 36.0 dB", 0.5)
        progress("refine: 37.5 dB", 0.9)
        progress("refine", 1.0)
        progress("write", 0.0)
    lines = [line.rpartition(":")[0].strip() for line in capsys.readouterr().err.splitlines()]
    assert lines == ["planning the watermark", "refining the watermark against distortions (37.5 dB)", "writing"]
