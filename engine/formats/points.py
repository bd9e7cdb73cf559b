"""Colored points as Gaussians of one size: what is left of a model that was exported as a point cloud, or as a mesh
with colors at its corners."""

from pathlib import Path

import numpy as np

from engine.errors import FormatError
from engine.formats.guards import beside
from engine.formats.ply.body import read_tables
from engine.formats.ply.dialects import COLORS, dc_of_colors
from engine.formats.ply.header import Header, parse_header
from engine.formats.ply.lists import plain_lists, read_lists
from engine.formats.repairs import Repair, clean
from engine.formats.textures import Textures
from engine.model import Float32, GaussianModel

_OPACITY_LOGIT = 2.2
"""Of each point, 0.9: what is seen is nearly the nearest."""

_SAMPLE, _NEIGHBOR = 4096, 4
_INDICES = ("vertex_indices", "vertex_index")
_COORDINATES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))


def read_points(
    data: bytes, *, file: str, folder: Path | None = None
) -> tuple[GaussianModel, tuple[Repair, ...]] | None:
    """Points of a PLY, or corners of an OBJ or a glTF, with a place and a color each; None where it has none of them,
    or is none of these. The `folder` is that of the textures and buffers that it may name.

    Every one becomes a ball of half the median distance to its fourth neighbor. Such a model is a suspect only: to mark
    or convert it would be to make up what it lacks.
    """
    is_ply = data.startswith((b"ply\n", b"ply\r"))
    found = _of_ply(data, folder, file) if is_ply else _of_mesh(data, folder, file)
    if found is None:
        return None
    means, dc = found
    count = len(means)
    sound = means[np.isfinite(means).all(axis=1)]
    size = 1.0
    if len(sound) > _NEIGHBOR:
        from scipy.spatial import cKDTree  # slow to load, and few suspects are points

        some = sound[:: -(-len(sound) // _SAMPLE)]
        size = float(np.median(cKDTree(sound).query(some, k=_NEIGHBOR + 1)[0][:, -1])) / 2
    logs = np.full((count, 3), np.log(size) if size > 0 else 0.0, np.float32)
    quats = np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1))
    model, repairs = clean(means, logs, quats, np.full(count, _OPACITY_LOGIT, np.float32), dc[:, None], file=file)
    text = (
        f"{count} colored points, no Gaussians: compared by their places and colors alone; a mark that is not found in"
        " them says little"
    )
    return model, (Repair("points", count, text), *repairs)


def _of_ply(data: bytes, folder: Path | None, file: str) -> tuple[Float32, Float32] | None:
    """Places and first coefficients, (N, 3) each."""
    header = plain_lists(data, parse_header(data, file=file), "vertex")
    vertex = header.element("vertex")
    if vertex is None or not {"x", "y", "z"} <= vertex.names or not vertex.count:
        return None
    colors = next((c for c in COLORS if set(c) <= vertex.names), None)
    if colors is None:
        return _textured(data, header, folder, file) if folder else None
    records = read_tables(data, header, ["vertex"], file=file)["vertex"]
    with np.errstate(over="ignore", invalid="ignore"):
        means = np.stack([records[axis].astype(np.float32) for axis in "xyz"], axis=1)
        rgb = np.stack([records[color].astype(np.float32) for color in colors], axis=1)
    return means, dc_of_colors(rgb, records.dtype[colors[0]])


def _textured(data: bytes, header: Header, folder: Path, file: str) -> tuple[Float32, Float32] | None:
    """The same of a mesh that names its textures in comments: with coordinates at its vertices, or at the corners of
    its faces as MeshLab writes them, of which the first with a vertex counts. They go up; vertices without are left
    out."""
    names = [text.split(None, 1)[1] for text in header.comments if text.lower().startswith("texturefile ")]
    vertex, face = header.element("vertex"), header.element("face")
    of_vertex, of_face = vertex.names if vertex else set(), {p.name for p in face.properties} if face else set()
    pair = next((pair for pair in _COORDINATES if set(pair) <= of_vertex), None)
    index = next((n for n in _INDICES if n in of_face), "")
    if not names or not (pair or (face and face.count and index and "texcoord" in of_face)):
        return None
    records = read_tables(data, header, ["vertex"], file=file)["vertex"]
    rows, number = np.arange(len(records)), np.zeros(len(records), np.int64)
    if pair:
        at = np.stack([records[name] for name in pair], axis=1)
    elif face:
        faces = read_lists(data, header, face, file=file)
        (corners, ends), (coordinates, at) = faces[index], faces["texcoord"]
        mapped = coordinates == 2 * corners
        at = at[np.repeat(mapped, coordinates)].reshape(-1, 2)
        number = np.repeat(faces["texnumber"][1] if "texnumber" in of_face else np.zeros(len(corners)), corners)
        rows, first = np.unique(ends[kept := np.repeat(mapped, corners)].astype(np.int64), return_index=True)
        if len(rows) and not 0 <= rows[0] <= rows[-1] < len(records):
            raise FormatError(f"a face names vertex {rows[-1]} of {len(records)}", file=file, element="face")
        at, number = at[first], number[kept][first]
    textures, rgb = Textures(file), np.full((len(rows), 3), np.nan, np.float32)
    for k in set(number.tolist()) & set(range(len(names))):
        here = number == k
        rgb[here] = textures.sample(beside(folder, names[k], file), at[here] * [1, -1] + [0, 1])
    seen = np.isfinite(rgb[:, 0])
    means = np.stack([records[axis][rows[seen]].astype(np.float32) for axis in "xyz"], axis=1)
    return (means, dc_of_colors(rgb[seen], rgb.dtype)) if seen.any() else None


def _of_mesh(data: bytes, folder: Path | None, file: str) -> tuple[Float32, Float32] | None:
    """The same of a glTF or an OBJ. Their axes stay: a suspect is registered however it stands."""
    from engine.formats.gltf.corners import read_corners  # loads what decodes textures
    from engine.formats.gltf.scene import looks_like_gltf
    from engine.formats.obj import read_obj

    found = read_corners(data, folder, file=file) if looks_like_gltf(data) else read_obj(data, folder, file=file)
    return None if found is None else (found[0], dc_of_colors(found[1], found[1].dtype))
