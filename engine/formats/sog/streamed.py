"""A streamed SOG scene, read as one model: the finest rows of every leaf, and what is always shown around them."""

from pathlib import Path

import numpy as np

from engine.errors import FormatError
from engine.formats.guards import check_count
from engine.formats.repairs import Repair
from engine.formats.sog.archive import MAX_META_BYTES, META, Archive, Folder, Within, ZipArchive
from engine.formats.sog.decoding import decode_scene
from engine.formats.sog.levels import LOD_META, MAX_LOD_META_BYTES, LodMeta, parse_lod_meta
from engine.formats.sog.meta import SogMeta, parse_meta
from engine.model import GaussianModel, joined

__all__ = ["read_streamed", "read_streamed_folder"]


def read_streamed(archive: ZipArchive, *, file: str) -> tuple[GaussianModel, tuple[Repair, ...]]:
    """Read a zip archive of such a scene, whose index may lie in a folder of its own.

    Coarser levels are left out, and reported; they only repeat the scene. UnsupportedFormatError for another version;
    FormatError if index, chunks and counts do not agree. Only what the index and a chunk's meta.json name is unpacked.
    """
    top = archive.folder_of(LOD_META)
    return _read(Within(archive, top), file)


def read_streamed_folder(folder: Path) -> tuple[GaussianModel, tuple[Repair, ...], tuple[str, ...]]:
    """The same of a folder; and the paths of all files that were read, relative to it, sorted."""
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
    index = parse_lod_meta(archive.read(LOD_META, MAX_LOD_META_BYTES), file=file)
    metas = {name: _meta(archive, name, file) for name in sorted(_wanted(index))}
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


def _meta(archive: Archive, name: str, file: str) -> SogMeta:
    return parse_meta(archive.read(name, MAX_META_BYTES), file=f"{file}, {name}")
