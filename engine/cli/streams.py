"""Standard input and output in place of files, by the name `-`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

from engine.cli.console import DATA_ON_STDOUT
from engine.errors import InputError

__all__ = ["STREAM", "check_kind", "check_stdout", "input_file", "input_name", "write_stdout"]

STREAM = Path("-")

MAX_INPUT_BYTES = 2 << 30
"""Of standard input, which ends in a temporary file: what the service takes as one upload by default."""
_BLOCK = 1 << 20


def input_name(path: Path, kind: str | None = None) -> str | None:
    """What messages call standard input, of a format that was named or not; None for a file, which has a name."""
    return None if path != STREAM else "standard input" + (f".{kind}" if kind else "")


def check_kind(found: str, wanted: str | None, path: Path) -> None:
    """InputError if an input is of another format than `--from` names."""
    if wanted not in (None, found):
        raise InputError(f"{input_name(path) or path}: is {found}, not {wanted!r} as --from says")


@contextmanager
def input_file(path: Path) -> Iterator[Path]:
    """The file itself; of `-`, a temporary one of what standard input holds. InputError if that is a terminal, or holds
    more than `MAX_INPUT_BYTES`."""
    if path != STREAM:
        yield path
        return
    if sys.stdin is None or sys.stdin.isatty():
        raise InputError("standard input is a terminal: pipe a file into it, or name one in place of '-'")
    with TemporaryDirectory(prefix="mark3dgs-") as folder:
        file = Path(folder, "standard input")
        with file.open("wb") as spool:
            _copy(sys.stdin.buffer, spool)
        yield file


def _copy(stream: BinaryIO, spool: BinaryIO) -> None:
    left = MAX_INPUT_BYTES
    while block := stream.read(_BLOCK):
        left -= len(block)
        if left < 0:
            most = f"{MAX_INPUT_BYTES / (1 << 30):g} GiB"
            raise InputError(f"standard input holds more than {most}: save it as a file, and name that in place of '-'")
        spool.write(block)


def check_stdout() -> None:
    """From now on what people or machines read goes to stderr. InputError if standard output is a terminal."""
    if sys.stdout is None or sys.stdout.isatty():
        raise InputError("standard output is a terminal: redirect it, or name a file in place of '-'")
    DATA_ON_STDOUT.set(True)


def write_stdout(data: bytes) -> int:
    """Write a whole file to standard output; returns its bytes."""
    sys.stdout.buffer.write(data)
    sys.stdout.buffer.flush()
    return len(data)
