"""A model inside something else: gzip, or a zip archive that is no format of its own, as platforms offer downloads."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats.guards import GZIP_MAGIC, gunzip
from engine.formats.kinds.splat import looks_like_splat
from engine.formats.ply.extras import named
from engine.formats.sog.archive import ZipArchive
from engine.formats.sog.levels import LOD_META

_FREE_BYTES, _RATIO = 1 << 28, 16
"""What may be unpacked of any file, or of each of its bytes: floats shrink to half, their text to a fourth."""

_MODELS = (".ply", ".spz", ".sog", ".splat", ".ksplat", ".glb", ".gltf", ".obj", ".usdz")
_NAMES_OTHERS = (".gltf", ".obj")
_OWN = ("means_l.webp", "means_l.png", LOD_META, ".usd", ".usda", ".usdc")
"""Ends of names in archives that are a format themselves; a meta.json alone may be anybody's."""


@contextmanager
def unwrapped(data: bytes, folder: Path | None, *, file: str) -> Iterator[tuple[bytes, Path | None, str]]:
    """The content of a model's file, the folder whose files it may name, and what it was unpacked from.

    `data`, `folder` and "" where it is inside nothing. The folder of an archive is a temporary one, with all that lies
    in it where the model's format names other files. FormatError if it is damaged, or holds more than its bytes can;
    UnsupportedFormatError if there are several models in it.
    """
    most, inside = max(_FREE_BYTES, _RATIO * len(data)), ""
    if looks_like_splat(data):  # it may begin with any bytes
        yield data, folder, inside
        return
    head = gunzip(data, 8, file=file) if data.startswith(GZIP_MAGIC) else b""
    if head and (not head.startswith(b"NGSP") or head[4:] == b"\4\0\0\0"):  # SPZ before version 4 is a gzip itself
        data, inside = gunzip(data, most + 1, file=file), "gzip"
        if len(data) > most:
            raise FormatError(f"unpacks to more than {most:,} bytes", file=file)
    name, archive = _model_in(data, file)
    if archive is None:
        yield data, folder, inside
        return
    with TemporaryDirectory(prefix="mark3dgs-") as place:
        if name.lower().endswith(_NAMES_OTHERS):
            _unpack(archive, Path(place), most, file)
        yield archive.read(name, most), Path(place, name).parent, repr(name[:80])


def _model_in(data: bytes, file: str) -> tuple[str, ZipArchive | None]:
    """The only model in a zip archive, by its name; no archive where there is none, or the archive is the model."""
    try:
        archive = ZipArchive(data, file=file) if data.startswith(b"PK") else None
    except FormatError:  # the reader of that format reports what is wrong with it
        archive = None
    names = archive.names if archive else []
    found = [name for name in names if name.lower().endswith(_MODELS) and not _is_hidden(name)]
    if not found or any(name.lower().endswith(_OWN) for name in names):
        return "", None
    if len(found) > 1:
        message = f"is a zip archive of {len(found)} models ({named(found)}): unpack it, and give one of them"
        raise UnsupportedFormatError(message, file=file)
    return found[0], archive


def _is_hidden(name: str) -> bool:
    """Whether an entry is none of the user's, such as the twin that macOS adds to each, or leads out of the archive."""
    parts = PurePosixPath(name).parts
    return name[1:2] == ":" or any(part.startswith((".", "/", "__MACOSX")) for part in parts)


def _unpack(archive: ZipArchive, place: Path, most: int, file: str) -> None:
    """All entries of an archive to a folder, at most so many bytes."""
    for name in archive.names:
        if not (name.endswith("/") or _is_hidden(name)):
            part = archive.read(name, most)
            most -= len(part)
            try:
                Path(place, name).parent.mkdir(parents=True, exist_ok=True)
                Path(place, name).write_bytes(part)
            except (OSError, ValueError) as fault:
                raise FormatError(f"cannot be unpacked ({fault})", file=file, element=name) from None
