"""What is checked before an untrusted file is read: what it is, and how much it may make the reader allocate."""

import gzip
import io
import json
import re
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from engine.errors import FormatError, InputError
from engine.numerics.plain import Json

FREE_COUNT = 1 << 20
"""Any file may hold this many: some 300 MB while it is read."""

GAUSSIANS_PER_BYTE = 4
"""Beyond that, at most four Gaussians a byte. Real scenes need 6 to 40 bytes for one; a quarter of a byte is
reached only by rows that all say the same (a 591 KB SPZ can hold 9.5 million of them, 608 MB)."""

SMALL_BYTES = 1 << 20
"""More than a key, a certificate or a stamp has."""

GZIP_MAGIC = b"\x1f\x8b"
_PIECE = 1 << 20
_ADDRESS = re.compile(r"(https?|ftp|s3|gs|file):/")  # of two slashes, a path keeps one


def check_count(count: int, size: int, *, file: str) -> None:
    """Refuse a number of Gaussians out of all proportion to the `size` bytes of the file (or of all files of a folder)
    that claims it: FormatError if it is zero, negative, or a decompression bomb."""
    if count < 1:
        raise FormatError(f"holds {count} Gaussians", file=file)
    if count > max(FREE_COUNT, GAUSSIANS_PER_BYTE * size):
        raise FormatError(f"claims {count} Gaussians in {size} bytes", file=file)


def gunzip(data: bytes, size: int, *, file: str) -> bytes:
    """The first bytes, at most `size`, of what a gzip file of one part or several holds; FormatError where it is
    damaged or cut off before their end, or anything but zeros follows."""
    try:
        content = io.BytesIO()
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as stream:  # in pieces: each is allocated before it is read
            while piece := stream.read(min(_PIECE, size - content.tell())):
                content.write(piece)
        return content.getvalue()
    except (gzip.BadGzipFile, EOFError, zlib.error) as fault:
        raise FormatError(f"damaged gzip stream, or bytes follow it ({fault})", file=file) from None


def json_object(text: bytes, *, file: str, element: str) -> Json:
    """The object that is the whole of a JSON text; FormatError where there is none."""
    try:
        parsed = json.loads(text)
    except (ValueError, RecursionError) as fault:
        raise FormatError(f"is no JSON ({ascii(str(fault))[:120]})", file=file, element=element) from None
    if not isinstance(parsed, dict):
        raise FormatError("is no JSON object", file=file, element=element)
    return parsed


@contextmanager
def opening(path: Path, file: str) -> Iterator[None]:
    """Say what is wrong with a path, called `file`, as InputError: it is no name, or may not be opened."""
    if "\0" in str(path):
        raise InputError(f"{file!r}: is no file name")
    try:
        yield
    except OSError as error:
        advice = "is an address: download the file, and give that" if _ADDRESS.match(file) else None
        raise InputError(f"{file}: {advice or f'cannot be read: {error.strerror or error}'}") from None


def read_small(path: Path) -> bytes:
    """A small file, its first SMALL_BYTES at most; InputError where it cannot be read."""
    with opening(path, str(path)), path.open("rb") as opened:
        return opened.read(SMALL_BYTES)


def read_regular(path: Path, file: str) -> bytes:
    """The content of a file; InputError if it is a pipe, a device and the like."""
    if path.exists() and not path.is_file():
        raise InputError(f"{file}: is no regular file")
    return path.read_bytes()


def beside(folder: Path, name: str, file: str) -> Path:
    """A file in the folder or below it, by a path of any system, which may be one of another machine; FormatError where
    there is none."""
    parts = [part for part in name.replace("\\", "/").split("/") if part]
    for path in (folder.joinpath(*parts), folder / parts[-1] if parts else folder):
        if "\0" not in name and path.is_file() and path.resolve().is_relative_to(folder.resolve()):
            return path
    message = f"names {name[:80]!a}, which is not beside it: give the files that it names together with it"
    raise FormatError(message, file=file)
