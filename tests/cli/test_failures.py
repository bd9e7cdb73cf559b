"""Errors as exit codes, one line and JSON."""

import json

import pytest

from engine.cli import keygen
from engine.cli.app import run
from engine.cli.failures import FAILED, INTERRUPTED, USAGE, describe, exit_code
from engine.errors import CapacityError, FormatError, InputError, KeyFileError, WrongKeyError


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (InputError("x"), USAGE),
        (FormatError("x"), USAGE),
        (KeyFileError("x"), USAGE),
        (WrongKeyError("x"), USAGE),
        (CapacityError("x", wanted=64, capacity=16), USAGE),
        (FileNotFoundError(2, "No such file", "a.ply"), USAGE),
        (OSError(28, "No space left on device", "out.ply"), FAILED),
        (MemoryError(), FAILED),
        (ZeroDivisionError("oops"), FAILED),
        (KeyboardInterrupt(), INTERRUPTED),
    ],
)
def test_exit_code(error: BaseException, code: int) -> None:
    assert exit_code(error) == code


def test_a_format_error_names_its_place() -> None:
    found = describe(FormatError("is NaN", file="a.ply", element="vertex", row=7, prop="x"))
    assert found["type"] == "FormatError"
    assert (found["file"], found["element"], found["row"], found["property"]) == ("a.ply", "vertex", 7, "x")
    assert "a.ply" in found["message"]


def test_a_capacity_error_says_what_would_fit() -> None:
    found = describe(CapacityError("too long", wanted=256, capacity=40))
    assert (found["wanted"], found["capacity"]) == (256, 40)


def test_messages_are_one_line() -> None:
    assert "\n" not in describe(InputError("a\n  b"))["message"]
    assert "\n" not in describe(RuntimeError("a\nb"))["message"]


def test_usage_error_is_one_line_on_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["embed"]) == USAGE
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("mark3dgs: Missing argument")
    assert captured.err.endswith("Try 'mark3dgs embed --help'.\n"), "which command's"


def test_usage_error_is_json_for_machines(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["embed", "--json", "--no-such-option"]) == USAGE
    captured = capsys.readouterr()
    assert json.loads(captured.out)["error"]["type"] == "UsageError"
    assert captured.err == ""


def test_unknown_command_is_a_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["steal"]) == USAGE
    said = capsys.readouterr().err
    assert "steal" in said
    assert said.endswith("Try 'mark3dgs --help'.\n")


@pytest.mark.parametrize("error", [KeyboardInterrupt(), RuntimeError("boom"), MemoryError()])
def test_errors_inside_a_command_end_without_a_traceback(
    error: BaseException, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: object
) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(keygen.Console, "say", fail)
    code = run(["keygen", f"{tmp_path}/k"])
    err = capsys.readouterr().err
    assert code == exit_code(error)
    assert err.count("\n") == 1
    assert "Traceback" not in err
