"""The kinds of model files: how each is told, read and written. A new format is a module and its entry here."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from engine.errors import UnsupportedFormatError
from engine.formats.ply.compressed import is_compressed, read_compressed_ply, write_compressed_ply
from engine.formats.ply.gaussians import read_ply, write_ply
from engine.formats.ply.header import parse_header
from engine.formats.repairs import Repair
from engine.formats.splat import looks_like_splat, read_splat, write_splat
from engine.model import GaussianModel

__all__ = ["FORMATS", "KINDS", "Kind", "Read", "kind_of"]

Read = tuple[GaussianModel, tuple[Repair, ...]]


@dataclass(frozen=True)
class Kind:
    """One format; its name is also the ending of its files. `file` is what messages call the file."""

    name: str
    told_by: Callable[[bytes, str], bool]  # (content, file) -> whether this is one
    read: Callable[[bytes, str, str], Read]  # (content, file, axes of an SPZ file) -> model and repairs
    write: Callable[[GaussianModel], Iterable[bytes]]  # model of at least one Gaussian -> pieces of the file


def _read_spz(data: bytes, file: str, spz_frame: str) -> Read:
    from engine.formats.spz.stream import read_spz

    return read_spz(data, file=file, frame=spz_frame)


def _write_spz(model: GaussianModel) -> Iterable[bytes]:
    from engine.formats.spz.stream import write_spz

    return [write_spz(model)]


def _read_sog(data: bytes, file: str, spz_frame: str) -> Read:
    from engine.formats.sog.bundle import read_sog

    return read_sog(data, file=file)


def _write_sog(model: GaussianModel) -> Iterable[bytes]:
    from engine.formats.sog.bundle import write_sog

    return [write_sog(model)]


def _is_ply(data: bytes, file: str, compressed: bool) -> bool:
    return data.startswith((b"ply\n", b"ply\r")) and is_compressed(parse_header(data, file=file)) is compressed


def _is_splat(data: bytes, file: str) -> bool:
    """It has no magic: what other formats start with, or call themselves, is none."""
    return not (data.startswith(_MAGICS) or file.lower().endswith(".ksplat")) and looks_like_splat(data)


_SPZ, _SOG = (b"\x1f\x8b", b"NGSP"), (b"PK",)
_MAGICS = (*_SPZ, *_SOG, b"ply\n", b"ply\r", b"glTF")

KINDS = (
    Kind(
        "ply",
        lambda data, file: _is_ply(data, file, compressed=False),
        lambda data, file, _: read_ply(data, file=file),
        write_ply,
    ),
    Kind(
        "compressed.ply",
        lambda data, file: _is_ply(data, file, compressed=True),
        lambda data, file, _: read_compressed_ply(data, file=file),
        lambda model: [write_compressed_ply(model)],
    ),
    Kind("splat", _is_splat, lambda data, file, _: read_splat(data, file=file), lambda model: [write_splat(model)]),
    Kind("spz", lambda data, file: data.startswith(_SPZ), _read_spz, _write_spz),
    Kind("sog", lambda data, file: data.startswith(_SOG), _read_sog, _write_sog),
)

FORMATS = tuple(kind.name for kind in KINDS)
"""What is read and written; also the file name's ending of each."""


def kind_of(name: str) -> Kind:
    """The format whose ending a file's name has."""
    for kind in sorted(KINDS, key=lambda kind: len(kind.name), reverse=True):  # .compressed.ply before .ply
        if name.lower().endswith("." + kind.name):
            return kind
    endings = ", ".join("." + format for format in FORMATS)
    raise UnsupportedFormatError(f"the name ends in none of {endings}", file=name)
