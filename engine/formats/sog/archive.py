"""Where the parts of a SOG scene lie: a zip archive or a folder. Only parts requested by name are read."""

import io
import struct
import zipfile
import zlib
from pathlib import Path

from engine.errors import FormatError

META = "meta.json"
MAX_META_BYTES = 1 << 20
"""Three codebooks of 256 numbers take 16 KB."""

_MAX_DIRECTORY_BYTES = 1 << 16
"""A bundle has eight entries of some 60 bytes; junk of operating systems may add a few dozen."""
_MAX_STREAMED_BYTES = 1 << 22
"""A streamed scene has seven entries a chunk: some 8,000 chunks."""
_STREAMED = b"lod-meta.json"

_ZIP64_RECORD = 56
"""Bytes of a ZIP64 end record without extensible data, which no program writes."""

_UNPACK = "unpack it, and give the model"
_EPOCH = (1980, 1, 1, 0, 0, 0)
_DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, struct.error, EOFError, OSError),
    *(RuntimeError, ValueError, OverflowError, LookupError),
)
"""What zipfile raises on archives that are damaged, encrypted or beyond it."""


class ZipArchive:
    """A bundled scene; `size` are its bytes as stored."""

    def __init__(self, data: bytes, *, file: str) -> None:
        self.size, self._file = len(data), file
        _check_directory(data, file=file)
        try:
            self._zip = zipfile.ZipFile(io.BytesIO(data))
            entries = self._zip.infolist()
        except _DAMAGE as fault:
            raise FormatError(f"damaged zip archive ({fault})", file=file) from None
        self._entries: dict[str, zipfile.ZipInfo] = {}
        for entry in entries:
            # Some programs on Windows write backslashes, tar writes "./".
            name = entry.filename.replace("\\", "/").removeprefix("./")
            if name in self._entries:
                raise FormatError(f"zip archive holds two entries of this name: {_UNPACK}", file=file, element=name)
            self._entries[name] = entry

    def read(self, name: str, limit: int) -> bytes:
        """One part of at most `limit` bytes; FormatError if it is missing, longer or damaged."""
        entry = self._entries.get(name)
        if entry is None:
            raise FormatError("zip archive lacks this entry", file=self._file, element=name)
        if entry.file_size > limit:
            raise FormatError(f"{entry.file_size} bytes, at most {limit} expected", file=self._file, element=name)
        if entry.flag_bits & 1 or entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            message = "is encrypted, or neither stored nor deflated: unpack the archive"
            raise FormatError(message, file=self._file, element=name)
        try:
            with self._zip.open(entry) as stream:
                part = stream.read(limit + 1)
        except _DAMAGE as fault:
            raise FormatError(f"damaged zip entry ({fault})", file=self._file, element=name) from None
        if len(part) != entry.file_size:
            message = f"unpacks to {len(part)} bytes, expected {entry.file_size}"
            raise FormatError(message, file=self._file, element=name)
        return part

    def folder_of(self, name: str) -> str:
        """The folder, ending in a slash, that holds a part of this name: the outermost; empty for the top.

        FormatError if there is none, or several folders as far out hold one.
        """
        found = sorted(path for path in self._entries if path == name or path.endswith("/" + name))
        if not found:
            raise FormatError("zip archive lacks this entry", file=self._file, element=name)
        depth = min(path.count("/") for path in found)
        outermost = [path for path in found if path.count("/") == depth]
        if len(outermost) > 1:
            text = f"zip archive holds {len(outermost)} scenes ({', '.join(outermost[:3])[:120]}): give one of them"
            raise FormatError(text, file=self._file)
        return outermost[0].removesuffix(name)

    @property
    def names(self) -> list[str]:
        """Paths of all entries."""
        return list(self._entries)

    def has(self, name: str) -> bool:
        """Whether there is a part of this name, at the top or in a folder."""
        return any(path == name or path.endswith("/" + name) for path in self._entries)


class Within:
    """A folder inside an archive, by its path, which ends in a slash."""

    def __init__(self, archive: "Archive", folder: str) -> None:
        self._archive, self._folder = archive, folder
        self.size: int = archive.size

    def read(self, name: str, limit: int) -> bytes:
        return self._archive.read(self._folder + name, limit)


class Folder:
    """An unbundled scene; the folder is the user's own, the names in it come from the caller checked."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.size = 0

    def read(self, name: str, limit: int) -> bytes:
        path = self._folder / name
        try:
            if path.stat().st_size > limit:
                message = f"{path.stat().st_size} bytes, at most {limit} expected"
                raise FormatError(message, file=str(self._folder), element=name)
            return path.read_bytes()
        except OSError as fault:
            raise FormatError(f"cannot be read ({fault.strerror})", file=str(self._folder), element=name) from None

    def weigh(self, names: tuple[str, ...]) -> None:
        """Set `size` to the sum of the parts named; missing ones count nothing."""
        self.size = sum(p.stat().st_size for p in (self._folder / name for name in names) if p.is_file())


Archive = ZipArchive | Within | Folder
"""Parts of a scene by plain name."""


def write_zip(parts: dict[str, bytes]) -> bytes:
    """A zip archive of stored entries, without dates or other traces of the machine."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name, part in parts.items():
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.create_system, entry.external_attr = 3, 0o644 << 16
            archive.writestr(entry, part)
    return buffer.getvalue()


def _check_directory(data: bytes, *, file: str) -> None:
    """Refuse a long list of entries before zipfile builds an object for each."""
    end = data.rfind(b"PK\x05\x06", max(0, len(data) - (1 << 16) - 22))
    if end < 0 or end + 22 > len(data):
        raise FormatError("is no zip archive, or its end is cut off", file=file)
    size = struct.unpack_from("<I", data, end + 12)[0]
    if data[max(0, end - 20) : end].startswith(b"PK\x06\x07"):  # ZIP64: its record stands before its locator
        end -= 20 + _ZIP64_RECORD
        if end < 0 or data[end : end + 4] != b"PK\x06\x06":
            raise FormatError("damaged zip archive (its ZIP64 record is not where it should be)", file=file)
        size = struct.unpack_from("<Q", data, end + 40)[0]
    most = _MAX_STREAMED_BYTES if _STREAMED in data[max(0, end - size) : end] else _MAX_DIRECTORY_BYTES
    if size > most:
        raise FormatError(f"zip archive lists far more entries than a scene has: {_UNPACK}", file=file)
