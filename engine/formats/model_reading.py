"""Any file of Gaussians, recognized by its first bytes and not by its name."""

import hashlib
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats.declaration import Kind, Place, Read
from engine.formats.guards import opening, read_regular
from engine.formats.kinds.splat import RECORD, SPLAT, looks_like_splat
from engine.formats.known_formats import KINDS, READ
from engine.formats.other_files import ZIP_WITHOUT_SCENE, advice_for, changed_as_text
from engine.formats.repairs import Repair
from engine.formats.sog.archive import ZipArchive
from engine.formats.wrappings import unwrapped
from engine.model import GaussianModel

_META, _LOD_META = "meta.json", "lod-meta.json"
_MODELS = (".ply", ".spz", ".sog", ".splat", ".ksplat", ".glb")


@dataclass(frozen=True)
class LoadedModel:
    """A model as it came from a file, with what is worth knowing about that file."""

    model: GaussianModel
    format: str  # one of `READ`
    repairs: tuple[Repair, ...]  # harmless faults that were mended or ignored
    source_bytes: int  # of the file and those that it names, or of all files of a folder
    sha256: str
    """Of the file, hexadecimal. Of a folder, or a file that names others: of the list of these files' own SHA-256,
    sorted by name, a line ``<sha256>  <name>`` each, as ``sha256sum`` prints them."""


def read_model(
    path_or_bytes: str | os.PathLike[str] | bytes | bytearray | memoryview,
    *,
    name: str | None = None,
    spz_frame: str = "auto",
) -> LoadedModel:
    """Read a Gaussian model of any format in `READ`: a file, the folder of an unpacked or streamed SOG scene (or
    its ``meta.json`` or ``lod-meta.json``), or the content of a file.

    `name` is what to call the input in messages, by default its path; it is never opened, and where it is given, files
    that the input names (buffers of a .gltf) are not either. `spz_frame` are the axes of
    an SPZ file, which often does not say: "spec" and "ply" overrule "auto", see `read_spz`.

    FormatError if the file cannot be read, naming file, element, row and property; UnsupportedFormatError if it is of
    no known format, or holds what has no place in a model; InputError if there is no such file, or it
    may not be opened.
    """
    if isinstance(path_or_bytes, bytes | bytearray | memoryview):
        return _decode(bytes(path_or_bytes), name or "(bytes)", Place(spz_frame))
    path = Path(path_or_bytes)
    file = name or str(path)
    with opening(path, file):
        if path.name in (_META, _LOD_META) and path.is_file():
            path = path.parent
        if path.is_dir():
            return _read_folder(path, file)
        data = read_regular(path, file)
    place = Place(spz_frame, path.parent if name is None else None)
    loaded = _decode(data, file, place)
    if not place.opened:
        return loaded
    size, digest = weigh_files(path.parent, {path.name, *(str(p.relative_to(path.parent)) for p in place.opened)})
    return replace(loaded, source_bytes=size, sha256=digest)


def _decode(data: bytes, file: str, place: Place) -> LoadedModel:
    try:
        with unwrapped(data, place.folder, file=file) as (content, folder, inside):
            if folder is not place.folder:  # of an archive
                file, place = f"{file}, {inside}", Place(place.spz_frame, folder)
            kind, (model, repairs) = _read(content, file, place)
    except MemoryError:
        raise FormatError(f"needs more memory than there is ({len(data)} bytes)", file=file) from None
    except FormatError:
        if changed := changed_as_text(data):
            raise FormatError(changed, file=file) from None
        raise
    if inside:
        repairs = (Repair("unwrapped", 1, f"unpacked first ({inside})"), *repairs)
    return LoadedModel(model, kind.name, repairs, len(data), hashlib.sha256(data).hexdigest())


def _read(data: bytes, file: str, place: Place) -> tuple[Kind, Read]:
    """The kind by its first bytes. A .splat may begin with those of another kind, by chance or to evade a check: it is
    recognized by its rows (in other files of real scenes up to 13 % look like rows of a .splat; half are needed)."""
    splat = looks_like_splat(data)
    try:
        kind = _told(data, file)
        read = kind.read(data, file, place)
    except FormatError:
        if not splat:
            raise
        return SPLAT, SPLAT.read(data, file, place)
    if splat and kind is not SPLAT:
        message = f"holds two models at once, a .{kind.name} and a .splat: keep the one that is meant"
        raise FormatError(message, file=file)
    return kind, read


def _told(data: bytes, file: str) -> Kind:
    for kind in KINDS:
        if kind.told_by(data, file):
            return kind
    if not data:
        raise FormatError("is empty", file=file)
    if looks_like_splat(data[: len(data) // RECORD.itemsize * RECORD.itemsize]):
        SPLAT.read(data, file, Place())  # says that it is cut off
    advice = advice_for(data, file)
    if advice == ZIP_WITHOUT_SCENE:
        ZipArchive(data, file=file)  # says where it is damaged
    raise UnsupportedFormatError(advice or f"is none of the formats read here: {', '.join(READ)}", file=file)


def _read_folder(path: Path, file: str) -> LoadedModel:
    from engine.formats.sog.bundle import read_sog_folder, read_streamed_folder

    if (path / _LOD_META).is_file():
        model, repairs, names = read_streamed_folder(path)
    elif (path / _META).is_file():
        model, repairs = read_sog_folder(path)
        there = sorted(path.iterdir(), key=lambda p: p.name)
        names = tuple(p.name for p in there if p.is_file() and (p.name == _META or p.suffix in (".webp", ".png")))
    else:
        message = f"is a folder without {_META} or {_LOD_META}: no unpacked SOG scene"
        models = [p for ending in _MODELS for p in (*path.glob(f"*{ending}"), *path.glob(f"point_cloud/*/*{ending}"))]
        if models:
            latest = max(models, key=lambda p: [int(n) for n in re.findall(r"\d+", p.parent.name)])
            message += f"; give a model in it, such as {str(latest.relative_to(path))[:120]!a}"
        raise UnsupportedFormatError(message, file=file)
    return LoadedModel(model, "sog", repairs, *weigh_files(path, names))


def weigh_files(folder: Path, names: Iterable[str]) -> tuple[int, str]:
    """Bytes of some of a folder's files, and the digest of them all: `LoadedModel.sha256`."""
    size, digests = 0, []
    for name in sorted(names):
        content = (folder / name).read_bytes()
        size += len(content)
        digests.append(f"{hashlib.sha256(content).hexdigest()}  {name}\n")
    return size, hashlib.sha256("".join(digests).encode("utf-8", "surrogateescape")).hexdigest()
