"""SOG, PlayCanvas's "Spatially Ordered Gaussians": a zip archive or folder of lossless WebP images.

Versions 1 ("SOGS") and 2 are read, 2 is written. Format: the SOG page of PlayCanvas's user manual, and the
readers of playcanvas/splat-transform. The axes are those of PLY.
"""

from __future__ import annotations

from pathlib import Path

from engine.errors import FormatError
from engine.formats.repairs import Repair
from engine.formats.sog_archive import MAX_META_BYTES, META, Folder, ZipArchive
from engine.formats.sog_decoding import decode_scene
from engine.formats.sog_meta import parse_meta
from engine.model import GaussianModel

__all__ = ["read_sog", "read_sog_folder"]


def read_sog(data: bytes, *, file: str) -> tuple[GaussianModel, tuple[Repair, ...]]:
    """Read a bundled scene, version 1 or 2.

    Parameters
    ----------
    data : bytes
        The whole zip archive. Only meta.json and the images it names are ever unpacked.
    file : str
        Its name, for messages.

    Returns
    -------
    model : GaussianModel
    repairs : tuple of Repair
        Harmless faults, mended; such as alpha 0 and 255, which no finite logit has.

    Raises
    ------
    UnsupportedFormatError
        Another version, or images that are lossy.
    FormatError
        The archive or an image is damaged, or sizes and counts do not agree; checked before it is decoded.
    """
    archive = ZipArchive(data, file=file)
    meta = parse_meta(archive.read(META, MAX_META_BYTES), file=file)
    return decode_scene(meta, archive, file=file)


def read_sog_folder(path: str | Path) -> tuple[GaussianModel, tuple[Repair, ...]]:
    """Read an unbundled scene: a folder with meta.json, or the path of that meta.json.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    model, repairs
        As `read_sog`.

    Raises
    ------
    FormatError
        As `read_sog`, or a part is missing or cannot be read.
    """
    path = Path(path)
    folder = path if path.is_dir() else path.parent
    if not path.is_dir() and path.name != META:
        raise FormatError(f"is neither a folder nor a {META}", file=str(path))
    archive = Folder(folder)
    meta = parse_meta(archive.read(META, MAX_META_BYTES), file=str(path))
    archive.weigh(meta.names)
    return decode_scene(meta, archive, file=str(path))
