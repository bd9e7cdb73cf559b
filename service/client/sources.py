"""Files and bytes to send, read a piece at a time."""

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

PIECE = 8 << 20
"""Bytes of one request: what a broken connection costs at most."""

Source = str | os.PathLike[str] | bytes
"""A file's path, or its content."""


@dataclass(frozen=True)
class Measured:
    """What is announced of a source before it is sent."""

    name: str
    size: int
    sha256: str


def measure(source: Source) -> Measured:
    """Name, size and digest; OSError where the file cannot be read."""
    if isinstance(source, bytes):
        return Measured("", len(source), hashlib.sha256(source).hexdigest())
    path = Path(source)
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        return Measured(path.name[:200], file.tell(), digest)


def piece(source: Source, start: int) -> bytes:
    """The bytes from `start` on, at most PIECE."""
    if isinstance(source, bytes):
        return source[start : start + PIECE]
    with Path(source).open("rb") as file:
        file.seek(start)
        return file.read(PIECE)


def digest_of(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
