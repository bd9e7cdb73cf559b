"""Errors of the engine, as problems of the service."""

from __future__ import annotations

import errno
from typing import Any

import pytest

from engine.errors import (
    CameraError,
    CapacityError,
    FormatError,
    InputError,
    KeyFileError,
    UnsupportedFormatError,
    WrongKeyError,
)
from service.problems import KINDS, Problem
from service.work.process import describe

FORMAT = FormatError("is NaN", file="/data/blob/ab/abcdef", element="vertex", row=7, prop="x")


@pytest.mark.parametrize(
    ("error", "kind", "extra"),
    [
        (FORMAT, "unreadable-model", {"element": "vertex", "row": 7, "property": "x"}),
        (UnsupportedFormatError("a .ksplat is not read here"), "unreadable-model", {}),
        (CameraError("no focal length"), "unreadable-cameras", {}),
        (CapacityError("too many", wanted=64, capacity=12), "capacity", {"wanted": 64, "capacity": 12}),
        (InputError("psnr must be positive"), "invalid-request", {}),
        (KeyFileError("too short"), "invalid-request", {}),
        (Problem("unreadable-image", "no picture", name="a.png"), "unreadable-image", {"name": "a.png"}),
        (MemoryError(), "engine-limit", {}),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried"), "engine-limit", {}),
        (OSError(errno.EFBIG, "File too large"), "engine-limit", {}),
        (OSError(errno.ENOSPC, "No space left on device"), "storage-full", {}),
        (WrongKeyError("sealed under another key"), "internal", {}),
        (ZeroDivisionError("secret"), "internal", {}),
    ],
)
def test_kinds(error: Exception, kind: str, extra: dict[str, Any]) -> None:
    plain = describe(error)
    assert plain["kind"] == kind
    assert kind in KINDS
    assert {name: plain[name] for name in plain if name not in ("kind", "detail")} == extra
    assert plain["detail"]


def test_what_cannot_be_read_is_called_by_its_name() -> None:
    assert describe(FORMAT)["detail"] == "the model: element 'vertex', row 7, property 'x': is NaN"
    named = {"model": "/data/blob/ab/abcdef", "name": "scans/pot.ply"}
    assert describe(FormatError("is empty", file=named["model"]), named)["detail"] == "pot.ply: is empty"


def test_what_a_bug_says_stays_here() -> None:
    assert "secret" not in describe(ZeroDivisionError("secret"))["detail"]


def test_paths_of_this_machine_stay_here() -> None:
    assert "/data" not in describe(FORMAT)["detail"]
    request = {"model": "/data/blob/ab/abcdef", "images": ["/data/scratch/1.png"]}
    plain = describe(InputError("/data/blob/ab/abcdef and /data/scratch/1.png do not fit"), request)
    assert plain["detail"] == "abcdef and 1.png do not fit"
