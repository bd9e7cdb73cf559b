"""SOG, PlayCanvas's "Spatially Ordered Gaussians": a zip archive or folder of lossless WebP images.

Versions 1 ("SOGS") and 2 are read, 2 is written. Format: the SOG page of PlayCanvas's user manual, and the
readers of playcanvas/splat-transform. The axes are those of PLY.
"""

from pathlib import Path

from engine.errors import FormatError
from engine.formats.repairs import Repair
from engine.formats.sog.archive import MAX_META_BYTES, META, Folder, Within, ZipArchive, write_zip
from engine.formats.sog.decoding import decode_scene
from engine.formats.sog.encoding import encode_scene
from engine.formats.sog.levels import LOD_META
from engine.formats.sog.meta import parse_meta
from engine.model import GaussianModel

__all__ = ["read_sog", "read_sog_folder", "write_sog"]


def read_sog(data: bytes, *, file: str) -> tuple[GaussianModel, tuple[Repair, ...]]:
    """Read a bundled scene, version 1 or 2, or the archive of a streamed one, at the top or in a folder of the archive.
    Only meta.json and the images it names are ever unpacked.

    UnsupportedFormatError for another version, or images that are lossy; FormatError if the archive or an image is
    damaged, or sizes and counts do not agree; checked before it is decoded.
    """
    archive = ZipArchive(data, file=file)
    if archive.has(LOD_META):
        from engine.formats.sog.streamed import read_streamed

        return read_streamed(archive, file=file)
    scene = Within(archive, archive.folder_of(META))
    meta = parse_meta(scene.read(META, MAX_META_BYTES), file=file)
    return decode_scene(meta, scene, file=file)


def read_sog_folder(path: str | Path) -> tuple[GaussianModel, tuple[Repair, ...]]:
    """As `read_sog`, an unbundled scene: a folder with meta.json, or the path of that meta.json."""
    path = Path(path)
    folder = path if path.is_dir() else path.parent
    if not path.is_dir() and path.name != META:
        raise FormatError(f"is neither a folder nor a {META}", file=str(path))
    archive = Folder(folder)
    meta = parse_meta(archive.read(META, MAX_META_BYTES), file=str(path))
    archive.weigh(meta.names)
    return decode_scene(meta, archive, file=str(path))


def write_sog(model: GaussianModel) -> bytes:
    """Write a bundled scene, version 2; the Gaussians come out in another order (along a Z-curve).

    The same bytes for the same input, on any number of threads. Errors: centres half of 1/65535 of their range in the
    domain sign(x) log(1 + abs(x)), opacities 1/510, the three smaller components of a quaternion 0.0028 each; log
    scales, DC and code vectors that of the best 256 values for all of them.

    Spherical harmonics above DC become a palette of 1k to 64k code vectors, by the number of Gaussians as PlayCanvas's
    writer; exact where no more differ. InputError if the model is empty.
    """
    return write_zip(encode_scene(model))
