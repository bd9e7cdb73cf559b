"""Gaussian models as INRIA's PLY: every variant met in the wild is read; written with three scales, or two for
2DGS."""

# mypy: allow-untyped-defs

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats.modes import ANTIALIASED, comment_of, mode_of_comments, with_mode
from engine.formats.ply import extras
from engine.formats.ply.body import read_tables
from engine.formats.ply.dialects import DC, activation_hints, dc_of_colors, georeferenced, plain_names, plain_types
from engine.formats.ply.header import ANY_BYTES, Element, Header, parse_header
from engine.formats.ply.lists import plain_lists
from engine.formats.repairs import LOG_SCALE_RANGE, Repair, clean, degree_dropped
from engine.kernels.jit import kernel, parallel_kernel, share_of
from engine.model import DISC_THICKNESS, Float32, GaussianModel

REST_COUNTS = {0: 1, 9: 4, 24: 9, 45: 16, 72: 16}
"""Number of f_rest properties -> coefficients a channel that are read: of degree 4, those of degree 3."""

_AXES = ("x", "y", "z")
_NORMALS = ("nx", "ny", "nz")  # INRIA writes zeros there, viewers ignore them
_ANCHORS = ("f_anchor", "f_offset", "anchor_feat")
_HARMONICS = re.compile(r"(f_rest|shs?|shn|sh_rest|features?_rest|sh_coeffs?)(_?\d+(_\d+)?|\[\d+\])", re.IGNORECASE)
_ROWS_AT_ONCE = 4096  # 1 MB of records: stays in the second-level cache while its columns are spread


def read_ply(data: bytes | memoryview, *, file: str) -> tuple[GaussianModel, tuple[Repair, ...]]:
    """Read an uncompressed Gaussian PLY: binary of either byte order or ASCII, 3DGS or 2DGS, degree 0 to 3; degree 4 up
    to degree 3.

    Repairs report ``extra_properties``, ``extra_elements``, ``flat_discs``, ``filter_fused`` and what
    `engine.formats.ply.dialects` translates, too. FormatError if the bytes are not what the header says, or a property
    is missing or holds whole numbers; UnsupportedFormatError if the file is a point cloud or a mesh, or its Gaussians
    move or lie in codebooks.
    """
    header, renamed = plain_names(plain_lists(data, parse_header(data, file=file), "vertex"))
    vertex, used, more, repairs = _check_vertex(header, file)
    records = read_tables(data, header, ["vertex"], file=file)["vertex"]
    _check_order(records, file)
    repairs = [*renamed, *extras.carrying(header, more), *repairs]
    if any(records[name].any() for name in _NORMALS if name in vertex.names):
        more = [p.name for p in vertex.properties if p.name in (*more, *_NORMALS)]
    colored = any(repair.code == "colors_read" for repair in renamed)
    records, typed = plain_types(records, [name for name in used if not (colored and name in DC)], file=file)
    repairs += typed
    rest = _count_rest(vertex, file)
    shapes = {"means": (3,), "log_scales": (3,), "quats": (4,), "opacity_logits": (), "sh": (REST_COUNTS[rest], 3)}
    arrays = {name: np.empty((len(records), *shape), np.float32) for name, shape in shapes.items()}
    _spread(records, arrays, frozenset(used), rest // 3)
    if colored:
        arrays["sh"][:, 0] = dc_of_colors(arrays["sh"][:, 0], records.dtype[DC[0]])
    log_scales = arrays["log_scales"]
    if "scale_1" not in vertex.names:
        log_scales[:, 1:] = log_scales[:, :1]
        if "rot_0" not in vertex.names:
            arrays["quats"][:] = [1, 0, 0, 0]
        repairs.append(Repair("isotropic", len(records), "balls of one scale: it was taken for all three axes"))
    elif "scale_2" not in vertex.names:
        log_scales[:, 2] = np.maximum(log_scales[:, :2].min(axis=1) + np.log(DISC_THICKNESS), LOG_SCALE_RANGE[0])
        text = f"2DGS discs: their third scale was set to {DISC_THICKNESS:g} of the smaller one"
        repairs.append(Repair("flat_discs", len(records), text))
    mode = mode_of_comments(header.comments)
    if extras.FILTER in vertex.names:
        width = records[extras.FILTER].astype(np.float32)
        fused = extras.fuse_filter(arrays["log_scales"], arrays["opacity_logits"], width)
        arrays["log_scales"], arrays["opacity_logits"] = fused
        text = f"Mip-Splatting's {extras.FILTER!r} was folded into sizes and opacities, as its own export does"
        repairs.append(Repair("filter_fused", len(records), text))
        mode = mode or ANTIALIASED
    logits = arrays["opacity_logits"]
    origin, moved = georeferenced(records, arrays["means"], arrays["log_scales"])
    repairs += [*moved, *activation_hints(arrays["log_scales"], logits, arrays["sh"][:, 0])]
    model, mended = clean(arrays["means"], arrays["log_scales"], arrays["quats"], logits, arrays["sh"], file=file)
    rows = None if model.file_rows is None else model.file_rows.rows
    model = model.with_(origin=origin, carried=extras.carried_by(header, records, more, rows))
    return with_mode(model, mode), (*repairs, *mended)


def write_ply(model: GaussianModel) -> Iterator[bytes]:
    """The file in pieces: header, then rows; float32 little endian, INRIA's property order with zero normals; the
    centers of a model with an origin as doubles, with it added.

    Discs (`GaussianModel.is_flat`) get two scales, as 2DGS writes them; what the model carries follows. Reading gives
    the same bits back.
    """
    rest = 3 * (model.sh.shape[1] - 1)
    names = ["x", "y", "z", *_NORMALS, "f_dc_0", "f_dc_1", "f_dc_2"]
    names += [f"f_rest_{i}" for i in range(rest)]
    scales = ["scale_0", "scale_1"] if model.is_flat else ["scale_0", "scale_1", "scale_2"]
    names += ["opacity", *scales, "rot_0", "rot_1", "rot_2", "rot_3"]
    comment = comment_of(model) if not model.is_flat else []  # two scales say it
    comments, properties = extras.lines_of(model.carried)
    lines = ["ply", "format binary_little_endian 1.0", *comment, *comments, f"element vertex {len(model)}"]
    more = () if model.carried is None else model.carried.names
    names = [name for name in names if name not in more]  # normals that are carried
    kinds = {name: "double" if any(model.origin) and name in _AXES else "float" for name in names}
    lines += [f"property {kinds[name]} {name}" for name in names] + properties
    yield ("\n".join([*lines, "end_header"]) + "\n").encode(*ANY_BYTES)

    arrays = {name: getattr(model, name) for name in ("means", "log_scales", "quats", "opacity_logits", "sh")}
    columns: dict[str, npt.NDArray[Any]] = dict(_columns(arrays, frozenset(names)))
    dtype = [(name, "<f8" if kinds[name] == "double" else "<f4") for name in names]
    if model.carried is not None:
        columns |= {name: model.carried.columns[name] for name in more}
        dtype += [(name, model.carried.columns.dtype[name].str) for name in more]
    for start in range(0, len(model), _ROWS_AT_ONCE):
        stop = min(start + _ROWS_AT_ONCE, len(model))
        rows = np.zeros(stop - start, dtype)
        for name in columns:
            rows[name] = columns[name][start:stop]
        if any(model.origin):
            for axis, shift in zip(_AXES, model.origin, strict=True):
                rows[axis] += shift
        yield rows.tobytes()


def _check_vertex(header: Header, file: str) -> tuple[Element, list[str], list[str], list[Repair]]:
    """The vertex element once it is known to hold Gaussians, the properties that are read, those that are none of a
    Gaussian, and what the file holds besides."""
    extras.refuse_elements(header, file=file)
    vertex = header.element("vertex")
    if vertex is None:
        there = ", ".join(repr(e.name) for e in header.elements[:5])
        raise FormatError(f"has no element 'vertex', only {there}", file=file)
    if vertex.names & {"f_dc_0", "scale_0", "rot_0"}:
        extras.refuse_motion(vertex, file=file)
    if "f_dc_0" not in vertex.names and any(name.startswith(_ANCHORS) for name in vertex.names):
        message = "holds anchors of a neural model (Scaffold-GS, Octree-GS): a network makes Gaussians of them for each"
        raise UnsupportedFormatError(message + " view; export plain Gaussians", file=file, element="vertex")
    if "f_dc_0" not in vertex.names and "beta" in vertex.names:
        message = "is of Deformable Beta Splatting, whose kernels are no Gaussians: train the scene as Gaussians"
        raise UnsupportedFormatError(message, file=file, element="vertex", prop="beta")
    if "f_dc_0" not in vertex.names and "opacity" in vertex.names:
        message = f"is missing{_unknown(vertex)}; where the colors lie in codebook files (Compact3D), give the folder"
        raise FormatError(message, file=file, element="vertex", prop="f_dc_0")
    if not vertex.names & {"f_dc_0", "scale_0", "rot_0"}:
        colored = {"red", "green", "blue"} <= vertex.names
        what = "a colored point cloud" if colored else "a point cloud or a mesh"
        message = f"is {what}, not a Gaussian model: it has no colors f_dc_0, scales, rotations and opacity; trainers"
        message += " write theirs to point_cloud/iteration_N/point_cloud.ply, or splat.ply"
        raise UnsupportedFormatError(message, file=file, element="vertex")
    needed = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1"]
    rotations = {f"rot_{i}" for i in range(4)}
    is_ball = "scale_0" in vertex.names and not vertex.names & {"scale_1", "scale_2"}
    ball = is_ball and not vertex.names & rotations
    for name in needed[:-1] if ball else [*needed[: 9 - is_ball], *sorted(rotations)]:
        if name not in vertex.names:
            raise FormatError(f"is missing{_unknown(vertex)}", file=file, element="vertex", prop=name)

    harmonics = [name for name in vertex.names if _HARMONICS.fullmatch(name)]
    if harmonics and "f_rest_0" not in vertex.names:
        message = f"is missing, but {len(harmonics)} properties such as {min(harmonics)!a} look like harmonics: name"
        message += " them f_rest_0 and so on, all of red first, then green, then blue"
        raise FormatError(message, file=file, element="vertex", prop="f_rest_0")
    repairs: list[Repair] = []
    rest = _count_rest(vertex, file)
    known = {*needed, extras.FILTER, "scale_2", *rotations, *(f"f_rest_{i}" for i in range(rest))}
    used = [p.name for p in vertex.properties if p.name in known]
    extra = [p.name for p in vertex.properties if p.name not in known and p.name not in _NORMALS]
    if rest not in (0, 9, 24, 45):
        repairs.append(degree_dropped(4, vertex.count))
    others = [e.name for e in header.elements if e is not vertex]
    if others:
        repairs.append(extras.ignored("elements", others))
    return vertex, used, extra, repairs


def _unknown(vertex: Element) -> str:
    """What to do with properties that no Gaussian has, if there are some."""
    known = re.compile(r"[xyz]|n[xyz]|opacity|(f_dc|f_rest|scale|rot)_\d+")
    others = [p.name for p in vertex.properties if not known.fullmatch(p.name)]
    return f"; not known here: {extras.named(others)}: give each the name that INRIA's files have" if others else ""


def _check_order(records: npt.NDArray[Any], file: str) -> None:
    """FormatError where most centers are no numbers of a scene, but are in the other byte order."""
    sample = records[:: 1 + len(records) // _ROWS_AT_ONCE]
    with np.errstate(invalid="ignore"):  # signalling NaN of halves
        centers = np.stack([sample[axis] for axis in _AXES])
    if centers.dtype.kind == "f" and centers.itemsize > 2 and _sound(centers) < 0.5 < 0.9 < _sound(centers.byteswap()):
        message = "is in the other byte order than the header says: export it again, or correct its second line"
        raise FormatError(message, file=file, element="vertex", prop="x")


def _sound(centers: npt.NDArray[Any]) -> float:
    """Share of centers (3, N) that a scene may have."""
    with np.errstate(invalid="ignore"):
        sizes = np.abs(centers)
        sound = ((sizes < 1e9) & ((sizes > 1e-9) | (sizes == 0))).all(axis=0)
    return np.count_nonzero(sound) / max(len(sound), 1)


def _count_rest(vertex: Element, file: str) -> int:
    """Number of f_rest properties, once they are known to be the first so many."""
    names = {name for name in vertex.names if name.startswith("f_rest_")}
    if len(names) not in REST_COUNTS:
        message = f"{len(names)} properties f_rest_*, expected 0, 9, 24, 45 or 72 (degree 0 to 4)"
        raise FormatError(message, file=file, element="vertex")
    for i in range(len(names)):
        if f"f_rest_{i}" not in names:
            raise FormatError("is missing", file=file, element="vertex", prop=f"f_rest_{i}")
    return len(names)


def _properties(coefficients: int, channel: int | None = None) -> dict[str, list[str]]:
    """Of each array, the property that each number of a row comes from; f_rest is channel-major in the file, nowhere
    else, with `channel` of them a channel, which is more than is read where the degree is 4."""
    rest = coefficients - 1
    stride = rest if channel is None else channel
    return {
        "means": ["x", "y", "z"],
        "log_scales": [f"scale_{i}" for i in range(3)],
        "quats": [f"rot_{i}" for i in range(4)],
        "opacity_logits": ["opacity"],
        "sh": [f"f_dc_{c}" for c in range(3)] + [f"f_rest_{c * stride + k}" for k in range(rest) for c in range(3)],
    }


def _columns(arrays: dict[str, Float32], present: frozenset[str], channel: int | None = None) -> dict[str, Float32]:
    """(N,) view on the arrays for every property."""
    return {
        name: arrays[array].reshape(len(arrays[array]), len(names))[:, i]
        for array, names in _properties(arrays["sh"].shape[1], channel).items()
        for i, name in enumerate(names)
        if name in present
    }


def _spread(records: npt.NDArray[Any], arrays: dict[str, Float32], present: frozenset[str], channel: int) -> None:
    """Copy the fields of the records into the arrays, whatever their type and byte order."""
    columns = _columns(arrays, present, channel)
    places = {name: field[1] for name, field in (records.dtype.fields or {}).items() if field[0] == np.dtype("<f4")}
    if places.keys() >= columns.keys():
        data = records.view(np.uint8).reshape(len(records), records.itemsize)
        properties = _properties(arrays["sh"].shape[1], channel)
        # What a file lacks, the third scale of discs, is set afterwards.
        sources = tuple(np.array([places.get(name, 0) for name in names]) for names in properties.values())
        rows = ((arrays[array], (len(records), len(names))) for array, names in properties.items())
        words = tuple(each.reshape(shape).view(np.uint32) for each, shape in rows)
        _spread_words(data, sources, words)
        return
    with np.errstate(over="ignore", invalid="ignore"):  # what is no float32 becomes inf or NaN, found as such
        for start in range(0, len(records), _ROWS_AT_ONCE):
            block = records[start : start + _ROWS_AT_ONCE]
            for name, column in columns.items():
                column[start : start + _ROWS_AT_ONCE] = block[name]


@parallel_kernel
def _spread_words(rows, sources, words, call):
    """Copy little-endian words of rows of bytes (N, stride) from where `sources`, a tuple of (K,) each, say, to
    `words`, a tuple of (N, K) each."""
    for i in share_of(len(rows), call):
        _copy(rows[i], sources[0], words[0][i])
        _copy(rows[i], sources[1], words[1][i])
        _copy(rows[i], sources[2], words[2][i])
        _copy(rows[i], sources[3], words[3][i])
        _copy(rows[i], sources[4], words[4][i])


@kernel
def _copy(row, sources, words):
    for k in range(len(sources)):
        at = sources[k]
        words[k] = (
            np.uint32(row[at])
            | np.uint32(row[at + 1]) << np.uint32(8)
            | np.uint32(row[at + 2]) << np.uint32(16)
            | np.uint32(row[at + 3]) << np.uint32(24)
        )
