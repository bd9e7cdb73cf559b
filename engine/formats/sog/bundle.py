"""SOG, PlayCanvas's "Spatially Ordered Gaussians": a zip archive or folder of lossless WebP images.

Versions 1 ("SOGS") and 2 are read, 2 is written. Format: the SOG page of PlayCanvas's user manual, and the
readers of playcanvas/splat-transform. The axes are those of PLY.

A streamed scene is read as one model: the finest rows of every leaf, and what is always shown around them.
"""

from pathlib import Path

import numpy as np

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats.guards import check_count
from engine.formats.other_files import ZIP_WITHOUT_SCENE
from engine.formats.repairs import Repair
from engine.formats.sog.archive import MAX_META_BYTES, META, Archive, Folder, Within, ZipArchive, write_zip
from engine.formats.sog.decoding import decode_scene
from engine.formats.sog.encoding import encode_scene
from engine.formats.sog.levels import LOD_META, MAX_LOD_META_BYTES, LodMeta, parse_lod_meta
from engine.formats.sog.meta import parse_meta
from engine.model import GaussianModel, joined


def read_sog(data: bytes, *, file: str) -> tuple[GaussianModel, tuple[Repair, ...]]:
    """Read a bundled scene, version 1 or 2, or the archive of a streamed one, at the top or in a folder of the archive.
    Only meta.json and the images it names are ever unpacked.

    UnsupportedFormatError for another version, or images that are lossy; FormatError if the archive or an image is
    damaged, or sizes and counts do not agree; checked before it is decoded.
    """
    archive = ZipArchive(data, file=file)
    if archive.has(LOD_META):
        return _read(Within(archive, archive.folder_of(LOD_META)), file)
    if not archive.has(META):  # its name is in a scene that the archive holds
        raise UnsupportedFormatError(ZIP_WITHOUT_SCENE, file=file)
    scene = Within(archive, archive.folder_of(META))
    meta = parse_meta(scene.read(META, MAX_META_BYTES), file=file)
    return decode_scene(meta, scene, file=file)


def read_sog_folder(path: str | Path) -> tuple[GaussianModel, tuple[Repair, ...]]:
    """As `read_sog`, an unbundled scene: a folder with meta.json."""
    archive = Folder(Path(path))
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


def read_streamed_folder(folder: Path) -> tuple[GaussianModel, tuple[Repair, ...], tuple[str, ...]]:
    """A streamed scene in a folder; and the paths of all files that were read, relative to it, sorted."""
    archive, file = Folder(folder), str(folder)
    index = parse_lod_meta(archive.read(LOD_META, MAX_LOD_META_BYTES), file=file)
    names = {LOD_META}
    for chunk in (*index.filenames, *([index.environment] if index.environment else [])):
        parent = chunk.removesuffix(META)
        meta = parse_meta(archive.read(chunk, MAX_META_BYTES), file=file)
        names |= {chunk, *(parent + name for name in meta.names)}
    archive.weigh(tuple(names))
    return *_read(archive, file), tuple(sorted(names))


def _read(archive: Archive, file: str) -> tuple[GaussianModel, tuple[Repair, ...]]:
    """A streamed scene. Coarser levels are left out, and reported; they only repeat the scene."""
    index = parse_lod_meta(archive.read(LOD_META, MAX_LOD_META_BYTES), file=file)
    metas = {
        name: parse_meta(archive.read(name, MAX_META_BYTES), file=f"{file}, {name}") for name in sorted(_wanted(index))
    }
    check_count(sum(meta.count for meta in metas.values()), archive.size, file=file)
    parts: list[GaussianModel] = []
    repairs: list[Repair] = []
    for name, rows in _wanted(index).items():
        meta, chunk = metas[name], Within(archive, name.removesuffix(META))
        kept = np.zeros(meta.count, dtype=np.bool_)
        for offset, count in rows:
            if offset + count > meta.count:
                message = f"the index names rows {offset} to {offset + count}; the chunk holds {meta.count} Gaussians"
                raise FormatError(message, file=file, element=name)
            kept[offset : offset + count] = True
        model, mended = decode_scene(meta, chunk, file=file)
        repairs += mended
        here = kept if model.file_rows is None else kept[model.file_rows.rows]
        parts.append(model.take(here).with_(file_rows=None) if rows else model)
    if index.left_out:
        text = f"{index.left_out} Gaussians of coarser levels were left out: they repeat the scene"
        repairs.append(Repair("levels_left_out", index.left_out, text))
    return joined(parts), tuple(repairs)


def _wanted(index: LodMeta) -> dict[str, list[tuple[int, int]]]:
    """Runs of rows (offset, count) by chunk; no runs stand for a whole one."""
    wanted: dict[str, list[tuple[int, int]]] = {}
    for rows in index.finest:
        wanted.setdefault(index.filenames[rows.file], []).append((rows.offset, rows.count))
    if index.environment is not None:
        wanted[index.environment] = []
    return wanted
