"""Spacetime Gaussians as the PLY of their public code ("lite" models), under the rules for hostile files."""

from collections.abc import Iterator

import numpy as np

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats.ply.body import read_tables
from engine.formats.ply.header import Element, parse_header
from engine.formats.repairs import MAGNITUDE_LIMIT, Repair, clean
from engine.model import FileRows, Float32
from engine.scenes.spacetime import SpacetimeModel

__all__ = ["is_spacetime", "read_spacetime_ply", "write_spacetime_ply"]

PROPERTIES = {
    "means": ("x", "y", "z"),
    "trbf_center": ("trbf_center",),
    "trbf_scale": ("trbf_scale",),
    "": ("nx", "ny", "nz"),
    "motion": tuple(f"motion_{i}" for i in range(9)),
    "colors": ("f_dc_0", "f_dc_1", "f_dc_2"),
    "opacity_logits": ("opacity",),
    "log_scales": ("scale_0", "scale_1", "scale_2"),
    "quats": ("rot_0", "rot_1", "rot_2", "rot_3"),
    "omega": ("omega_0", "omega_1", "omega_2", "omega_3"),
}
"""Attribute -> properties, in the order of the public code; the normals are zero and never read."""

TRBF_SCALE_LIMIT = 30.0
"""Logarithm of the temporal width, either side: shorter and longer lives are clamped to it."""

_ROWS_AT_ONCE = 4096


def is_spacetime(data: bytes | memoryview) -> bool:
    """Whether a PLY file holds Spacetime Gaussians; only the header is looked at. Not where it is broken: what else
    the bytes may be, or what is wrong with them, is said by `engine.formats.read_model`."""
    if bytes(data[:4]) not in (b"ply\n", b"ply\r"):
        return False
    try:
        vertex = parse_header(data, file="").element("vertex")
    except FormatError:
        return False
    return vertex is not None and "trbf_center" in vertex.names


def read_spacetime_ply(data: bytes | memoryview, *, file: str) -> tuple[SpacetimeModel, tuple[Repair, ...]]:
    """Read a "lite" Spacetime Gaussian PLY: f_dc is RGB as it shows, trbf_scale a logarithm.

    The model is finite everywhere. Quaternions keep their length, which matters relative to omega's. Repairs list rows
    left out, opacities and scales clamped, properties ignored. FormatError where the bytes are not
    what the header says, or a property is missing; UnsupportedFormatError for a "full" model, whose colours come out of
    a network that is not in the file.
    """
    header = parse_header(data, file=file)
    vertex = header.element("vertex")
    if vertex is None:
        raise FormatError("has no element 'vertex'", file=file)
    repairs = _check(vertex, file)
    records = read_tables(data, header, ["vertex"], file=file)["vertex"]
    if not len(records):
        raise FormatError("holds no Gaussians", file=file, element="vertex")
    arrays: dict[str, Float32] = {}
    with np.errstate(over="ignore", invalid="ignore"):  # what is no float32 becomes inf or NaN, found as such
        for attribute, names in PROPERTIES.items():
            if attribute:
                columns = [records[name].astype(np.float32) for name in names]
                arrays[attribute] = columns[0] if len(names) == 1 else np.stack(columns, axis=1)
    bad = np.isnan(arrays["opacity_logits"])  # (N,); an infinite one is clamped
    for attribute in arrays.keys() - {"opacity_logits"}:
        values = arrays[attribute].reshape(len(records), -1)  # (N, C)
        bad |= ~(np.abs(values) <= MAGNITUDE_LIMIT).all(axis=1)
    if bad.all():
        raise FormatError("no Gaussian is usable: each has a value that is no number", file=file, row=0)
    rows = FileRows(np.flatnonzero(~bad), len(bad)) if bad.any() else None
    if rows is not None:
        text = f"{int(bad.sum())} Gaussians (first in row {int(np.argmax(bad))}): left out, a value is no number"
        repairs.append(Repair("rows_dropped", int(bad.sum()), text))
        arrays = {name: values[~bad] for name, values in arrays.items()}
    wide = np.abs(arrays["trbf_scale"]) > TRBF_SCALE_LIMIT
    if wide.any():
        text = f"{int(wide.sum())} temporal widths were clamped to exp(+-{TRBF_SCALE_LIMIT:g})"
        repairs.append(Repair("lifetimes_clamped", int(wide.sum()), text))
        arrays["trbf_scale"] = np.clip(arrays["trbf_scale"], -TRBF_SCALE_LIMIT, TRBF_SCALE_LIMIT)
    unturned = np.tile(np.array([1, 0, 0, 0], dtype=np.float32), (len(arrays["means"]), 1))
    plain = (arrays["means"], arrays["log_scales"], unturned, arrays["opacity_logits"], arrays["colors"][:, None])
    model, mended = clean(*plain, file=file, rows=rows)
    arrays |= {"log_scales": model.log_scales, "opacity_logits": model.opacity_logits}
    return SpacetimeModel(**arrays), (*repairs, *mended)


def write_spacetime_ply(model: SpacetimeModel) -> Iterator[bytes]:
    """The file in pieces: header, then rows; float32 little endian, the public code's property order.

    Reading it gives the same bits back.
    """
    names = [name for group in PROPERTIES.values() for name in group]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(model)}"]
    lines += [f"property float {name}" for name in names]
    yield ("\n".join([*lines, "end_header"]) + "\n").encode("ascii")
    for start in range(0, len(model), _ROWS_AT_ONCE):
        rows = slice(start, start + _ROWS_AT_ONCE)
        count = len(model.means[rows])
        parts = [
            getattr(model, attribute)[rows].reshape(count, -1) if attribute else np.zeros((count, 3))
            for attribute in PROPERTIES
        ]
        yield np.concatenate(parts, axis=1).astype("<f4").tobytes()


def _check(vertex: Element, file: str) -> list[Repair]:
    """Refuse what is no lite model; report what it holds besides."""
    if "f_t_0" in vertex.names or "f_dc_3" in vertex.names:
        message = "is a full Spacetime model: a network that is not in the file turns its features into colours"
        raise UnsupportedFormatError(message, file=file, element="vertex")
    needed = [name for attribute, group in PROPERTIES.items() if attribute for name in group]
    for name in needed:
        if name not in vertex.names:
            raise FormatError("is missing", file=file, element="vertex", prop=name)
    extra = [p.name for p in vertex.properties if p.name not in {*needed, *PROPERTIES[""]}]
    if not extra:
        return []
    shown = ", ".join(repr(name[:40]) for name in extra[:5])
    return [Repair("extra_properties", len(extra), f"properties that were ignored: {shown}")]
