"""The kinds of model files: how each is recognized, read and written. A new format is a module and its entry here."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from engine.errors import UnsupportedFormatError
from engine.formats.ply.compressed import is_compressed, read_compressed_ply, write_compressed_ply
from engine.formats.ply.gaussians import read_ply, write_ply
from engine.formats.ply.header import parse_header
from engine.formats.repairs import Repair
from engine.formats.splat import looks_like_splat, read_splat, write_splat
from engine.model import GaussianModel

__all__ = ["FORMATS", "KINDS", "READ", "SPLAT", "Kind", "Read", "kind_of"]

Read = tuple[GaussianModel, tuple[Repair, ...]]


@dataclass(frozen=True)
class Kind:
    """One format; its name is also the ending of its files. `file` is what messages call the file."""

    name: str
    told_by: Callable[[bytes, str], bool]  # (content, file) -> whether this is one
    read: Callable[[bytes, str, str], Read]  # (content, file, axes of an SPZ file) -> model and repairs
    # model of at least one Gaussian -> pieces of the file; None for a format that is only read
    write: Callable[[GaussianModel], Iterable[bytes]] | None
    extra: bool = False  # whether reading and writing take packages that are not always installed


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


def _read_gltf(data: bytes, file: str, spz_frame: str) -> Read:
    from engine.formats.gltf.scene import read_gltf

    return read_gltf(data, file=file)


def _write_glb(model: GaussianModel) -> Iterable[bytes]:
    from engine.formats.gltf.scene import write_glb

    return write_glb(model)


def _read_ksplat(data: bytes, file: str, spz_frame: str) -> Read:
    from engine.formats.ksplat import read_ksplat

    return read_ksplat(data, file=file)


def _is_ksplat(data: bytes, file: str) -> bool:
    """It has no magic either: the name alone counts."""
    from engine.formats.ksplat import looks_like_ksplat

    named = file.lower().endswith(".ksplat") and len(data) > 0
    return not data.startswith(_MAGICS) and (named or looks_like_ksplat(data))


def _is_gltf(data: bytes, file: str) -> bool:
    from engine.formats.gltf.scene import looks_like_gltf

    return looks_like_gltf(data)


def _usd_kind(kind: str) -> Kind:
    def is_one(data: bytes, file: str) -> bool:
        from engine.formats.usd.scene import kind_of_usd

        return data.startswith(_USD) and kind_of_usd(data) == kind

    def read(data: bytes, file: str, spz_frame: str) -> Read:
        from engine.formats.usd.scene import read_usd

        return read_usd(data, file=file)

    def write(model: GaussianModel) -> Iterable[bytes]:
        from engine.formats.usd.scene import write_usd

        return [write_usd(model, kind)]

    return Kind(kind, is_one, read, write, extra=True)


def _is_ply(data: bytes, file: str, compressed: bool) -> bool:
    return data.startswith((b"ply\n", b"ply\r")) and is_compressed(parse_header(data, file=file)) is compressed


_SPZ, _SOG = (b"\x1f\x8b", b"NGSP"), (b"PK",)
_USD = (b"PXR-USDC", b"#usda", b"PK")
_MAGICS = (*_SPZ, *_USD, b"ply\n", b"ply\r", b"glTF")
SPLAT = Kind(
    "splat",
    lambda data, file: looks_like_splat(data),
    lambda data, file, _: read_splat(data, file=file),
    lambda model: [write_splat(model)],
)

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
    Kind("spz", lambda data, file: data.startswith(_SPZ), _read_spz, _write_spz),
    Kind("sog", lambda data, file: data.startswith(_SOG) and b"meta.json" in data, _read_sog, _write_sog),
    *map(_usd_kind, ("usda", "usdc", "usdz")),
    Kind("glb", _is_gltf, _read_gltf, _write_glb),
    # those without a magic come last
    Kind("ksplat", _is_ksplat, _read_ksplat, None),
    SPLAT,
)

FORMATS = tuple(kind.name for kind in KINDS if kind.write and not kind.extra)
"""What is always read and written; also the file name's ending of each."""
READ = tuple(kind.name for kind in KINDS)
"""What is read."""


def kind_of(name: str) -> Kind:
    """The format whose ending a file's name has; InputError where its packages are not installed."""
    writable = [kind for kind in KINDS if kind.write]
    lower = name.lower() + ("c" if name.lower().endswith(".usd") else "")
    for kind in sorted(writable, key=lambda kind: len(kind.name), reverse=True):  # .compressed.ply before .ply
        if lower.endswith("." + kind.name):
            if kind.extra:
                from engine.formats.usd.scene import load_usd

                load_usd(f"writing .{kind.name}")
            return kind
    endings = ", ".join("." + kind.name for kind in writable)
    raise UnsupportedFormatError(f"the name ends in none of {endings}", file=name)
