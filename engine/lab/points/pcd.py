"""Point clouds as PCD of the Point Cloud Library, version 0.7: ascii, binary, binary_compressed."""

import re
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError, UnsupportedFormatError
from engine.extras import load_extra
from engine.formats.ply.body import read_tables
from engine.formats.ply.header import MAX_HEADER_BYTES, Element, Header, Property
from engine.formats.repairs import Repair
from engine.lab.points.cloud import PointCloud, cloud_of_columns

_TYPES = {f"{kind}{size}" for kind in "IU" for size in (1, 2, 4, 8)} | {"F4", "F8"}
_KEYWORDS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
_ENCODINGS = ("ascii", "binary", "binary_compressed")
_NUMBER = re.compile(r"[0-9]{1,15}", re.ASCII)
_MAX_COLUMNS = 1024  # a point with histograms (FPFH: 33, VFH: 308) stays far below
_LZF_GROWTH = 88  # the longest copy of LZF is 264 bytes out of 3: no stream can grow by more

_ELEMENT = "points"


@dataclass(frozen=True)
class _PcdHeader:
    element: Element
    encoding: str
    size: int  # bytes, up to and with the newline after DATA


def looks_like_pcd(data: bytes | memoryview) -> bool:
    """Whether the file starts as PCD files do: with a comment that says so, or at once with VERSION."""
    return bytes(data[:64]).startswith((b"# .PCD", b"VERSION ", b"VERSION\t"))


def read_points_pcd(data: bytes | memoryview, *, file: str) -> tuple[PointCloud, tuple[Repair, ...]]:
    """Read a PCD file, without the points that an organized cloud leaves empty.

    The viewpoint of the header is not applied: it says where the scanner stood, not where the points lie. FormatError
    if the bytes are not what the header says, UnsupportedFormatError for another version than 0.7.
    """
    header = _parse_header(data, file)
    element = header.element
    if header.encoding == "binary_compressed":
        columns = _compressed_columns(data, header, file)
    else:
        layout = Header("" if header.encoding == "ascii" else "<", (element,), header.size)
        records = read_tables(data, layout, [_ELEMENT], file=file)[_ELEMENT]
        columns = {prop.name: records[prop.name] for prop in element.properties}
    return cloud_of_columns(columns, file=file, element=_ELEMENT)


def _compressed_columns(data: bytes | memoryview, header: _PcdHeader, file: str) -> dict[str, npt.NDArray[Any]]:
    """One column after the other, LZF over all."""
    lzf = load_extra("lzf", "capture", "reading compressed PCD")
    body = memoryview(data)[header.size :]
    if len(body) < 8:
        raise FormatError(f"{len(body)} bytes follow the header, too few for two sizes", file=file)
    packed, size = struct.unpack_from("<II", body)
    element = header.element
    if size != element.count * element.stride:
        message = f"the body unpacks to {size} bytes, but {element.count} points have {element.stride} each"
        raise FormatError(message, file=file, element=_ELEMENT)
    if packed != len(body) - 8:
        message = f"the body has {len(body) - 8} bytes, but says {packed}: cut off, or the size is wrong"
        raise FormatError(message, file=file, element=_ELEMENT)
    if size > _LZF_GROWTH * packed:
        raise FormatError(f"claims {size} bytes compressed to {packed}", file=file, element=_ELEMENT)
    try:
        unpacked = lzf.decompress(bytes(body[8:]), size)  # None: there is more
    except ValueError:
        raise FormatError("the compressed body is broken", file=file, element=_ELEMENT) from None
    if unpacked is None or len(unpacked) != size:
        there = "more" if unpacked is None else len(unpacked)
        raise FormatError(f"the compressed body holds {there} bytes, expected {size}", file=file, element=_ELEMENT)
    content = np.frombuffer(unpacked, dtype=np.uint8)
    columns, at = {}, 0
    for prop in element.properties:
        length = element.count * int(prop.code[1])
        columns[prop.name] = content[at : at + length].view("<" + prop.code)
        at += length
    return columns


def _parse_header(data: bytes | memoryview, file: str) -> _PcdHeader:
    """Header of a PCD file; allocates nothing that depends on the counts in it."""
    head = bytes(data[:MAX_HEADER_BYTES])
    entries: dict[str, list[str]] = {}
    start = 0
    while "DATA" not in entries:
        end = head.find(b"\n", start)
        if end < 0:
            what = "is cut off" if len(data) < MAX_HEADER_BYTES else f"is longer than {MAX_HEADER_BYTES} bytes"
            raise FormatError(f"the header {what}: no line 'DATA'", file=file)
        words = head[start:end].decode("latin-1").split()
        start = end + 1
        if not words or words[0].startswith("#"):
            continue
        if words[0] not in _KEYWORDS:
            raise FormatError(f"cannot read the header line {' '.join(words)[:40]!a}", file=file)
        if words[0] in entries:
            raise FormatError(f"the header has two lines {words[0]!r}", file=file)
        entries[words[0]] = words[1:]
    for name in ("FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT"):
        if name not in entries:
            raise FormatError(f"the header has no line {name!r}", file=file)
    if entries.get("VERSION", ["0.7"]) not in (["0.7"], [".7"]):
        shown = " ".join(entries["VERSION"])[:20]
        raise UnsupportedFormatError(f"PCD version {shown!a} is not read here, only 0.7", file=file)
    if len(entries["DATA"]) != 1 or entries["DATA"][0] not in _ENCODINGS:
        raise FormatError(f"unknown encoding {' '.join(entries['DATA'])[:40]!a}", file=file)
    return _PcdHeader(_parse_fields(entries, file), entries["DATA"][0], start)


def _parse_fields(entries: dict[str, list[str]], file: str) -> Element:
    names = entries["FIELDS"]
    counts = entries.get("COUNT", ["1"] * len(names))
    if not len(names) == len(entries["SIZE"]) == len(entries["TYPE"]) == len(counts) or not names:
        lengths = f"{len(names)}, {len(entries['SIZE'])}, {len(entries['TYPE'])} and {len(counts)}"
        raise FormatError(f"FIELDS, SIZE, TYPE and COUNT have {lengths} entries", file=file)
    properties: dict[str, Property] = {}
    for place, (name, size, kind, count) in enumerate(
        zip(names, entries["SIZE"], entries["TYPE"], counts, strict=True)
    ):
        if kind + size not in _TYPES:
            message = f"no type has TYPE {kind[:10]!a} and SIZE {size[:10]!a}"
            raise FormatError(message, file=file, element=_ELEMENT, prop=name[:40])
        repeats = _number(count, "COUNT", file)
        if not 1 <= repeats <= _MAX_COLUMNS - len(properties):
            message = f"COUNT {repeats}: a point has 1 to {_MAX_COLUMNS} values"
            raise FormatError(message, file=file, element=_ELEMENT, prop=name[:40])
        base = f"_{place}" if name == "_" else name  # PCL names all padding alike
        for k in range(repeats):
            full = base if repeats == 1 else f"{base}[{k}]"
            if full in properties:
                raise FormatError("announced twice", file=file, element=_ELEMENT, prop=full[:40])
            properties[full] = Property(full, kind.lower() + size)
    width, height = (_number(" ".join(entries[name]), name, file) for name in ("WIDTH", "HEIGHT"))
    total = width * height
    if "POINTS" in entries and _number(" ".join(entries["POINTS"]), "POINTS", file) != total:
        message = f"POINTS {entries['POINTS'][0]} is not WIDTH x HEIGHT = {total}"
        raise FormatError(message, file=file, element=_ELEMENT)
    return Element(_ELEMENT, total, tuple(properties.values()))


def _number(word: str, what: str, file: str) -> int:
    if not _NUMBER.fullmatch(word):
        raise FormatError(f"{what} {word[:40]!a} is no number", file=file, element=_ELEMENT)
    return int(word)
