"""Point cloud files made by hand, byte by byte from their specifications."""

from __future__ import annotations

import struct

import lzf
import numpy as np
import numpy.typing as npt

from engine.model import Float64

Bytes = npt.NDArray[np.uint8]

POINTS = np.array([[0.5, -1.25, 3.0], [1e3, 2.0, -0.125], [-4.0, 8.0, 16.0], [0.0, 0.25, -0.5]])
COLORS = np.array([[255, 0, 51], [0, 128, 255], [1, 2, 3], [200, 100, 50]], dtype=np.uint8)
INTENSITY = np.array([0.0, 7.0, 250.0, 65.0])
TIMES = np.array([10.0, 10.25, 10.5, 11.0])


def ply(points: Float64 = POINTS, colors: Bytes = COLORS, order: str = "<", faces: bool = False) -> bytes:
    """Colored points with intensity and time; order "" is ASCII."""
    form = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}[order]
    lines = ["ply", f"format {form} 1.0", "comment by hand", f"element vertex {len(points)}"]
    lines += [f"property double {name}" for name in "xyz"]
    lines += [f"property uchar {name}" for name in ("red", "green", "blue")]
    lines += ["property float intensity", "property double time"]
    if faces:
        lines += ["element face 1", "property list uchar int vertex_indices"]
    header = ("\n".join([*lines, "end_header"]) + "\n").encode()
    rows = zip(points, colors, _cycled(INTENSITY, points), _cycled(TIMES, points), strict=True)
    if not order:
        text = "".join(
            " ".join([*map(repr, p.tolist()), *map(str, c.tolist()), repr(float(i)), repr(float(t))]) + "\n"
            for p, c, i, t in rows
        )
        return header + text.encode() + (b"3 0 1 2\n" if faces else b"")
    body = b"".join(struct.pack(order + "3d3Bfd", *p, *c, i, t) for p, c, i, t in rows)
    return header + body + (struct.pack(order + "B3i", 3, 0, 1, 2) if faces else b"")


def pcd(points: Float64 = POINTS, colors: Bytes = COLORS, encoding: str = "binary", packed: str = "F") -> bytes:
    """x y z, padding, packed color (as float or integer), intensity, and time in integer nanoseconds."""
    n = len(points)
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z _ rgb intensity t\n"
        f"SIZE 4 4 4 1 4 4 8\nTYPE F F F U {packed} F U\nCOUNT 1 1 1 4 1 1 1\nWIDTH {n}\nHEIGHT 1\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA {encoding}\n"
    ).encode()
    c = colors.astype(np.uint32)
    rgb = (c[:, 0] << 16) | (c[:, 1] << 8) | c[:, 2]
    stamps = np.round(_cycled(TIMES, points) * 1e9).astype("<u8")
    places = points.astype("<f4")
    strength = _cycled(INTENSITY, points).astype("<f4")
    if encoding == "ascii":
        shown = rgb.view(np.float32) if packed == "F" else rgb
        lines = [
            f"{p[0]!s} {p[1]!s} {p[2]!s} 0 0 0 0 {s!s} {i!s} {t}"
            for p, s, i, t in zip(places, shown, strength, stamps, strict=True)
        ]
        return header + ("\n".join(lines) + "\n").encode()
    if encoding == "binary":
        rows = zip(places, rgb, strength, stamps, strict=True)
        return header + b"".join(struct.pack("<3f4xIfQ", *p, s, i, t) for p, s, i, t in rows)
    columns = [*places.T, np.zeros((4, n), np.uint8), rgb.astype("<u4"), strength, stamps]
    body = b"".join(np.ascontiguousarray(column).tobytes() for column in columns)
    squeezed = lzf.compress(body, 2 * len(body) + 16)
    return header + struct.pack("<II", len(squeezed), len(body)) + squeezed


LAS_SIZES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
TIMED, COLORED = {1, 3, 4, 5, 6, 7, 8, 9, 10}, {2, 3, 5, 7, 8, 10}


def las(
    points: Float64 = POINTS,
    colors: Bytes = COLORS,
    *,
    format: int = 3,
    minor: int = 2,
    classes: tuple[int, ...] = (),
    extra: int = 0,
    bits: int = 16,
    tail: bytes = b"",
    waveforms: int = 0,
) -> bytes:
    """LAS of any version and point format; `extra` bytes a point behind the standard ones."""
    n, size = len(points), {2: 227, 3: 235, 4: 375}[minor]
    stride, vlr = LAS_SIZES[format] + extra, 54 + 6
    scale, origin = 0.125, np.array([100.0, 0.0, -50.0])
    head = struct.pack("<4sHHI2H8sBB32s32sHH", b"LASF", 0, 0, 0, 0, 0, b"", 1, minor, b"hand", b"", 1, 2026)
    legacy = n if format <= 5 else 0
    head += struct.pack("<HIIBHI5I", size, size + vlr, 1, format, stride, legacy, *(legacy, 0, 0, 0, 0))
    head += struct.pack("<12d", *[scale] * 3, *origin, *np.stack([points.max(0), points.min(0)], 1).ravel())
    if minor >= 3:
        head += struct.pack("<Q", waveforms)
    if minor == 4:
        head += struct.pack("<QIQ15Q", 0, 0, n, n, *[0] * 14)
    assert len(head) == size
    body = struct.pack("<H16sHH32s", 0, b"hand", 1, 6, b"nothing") + b"ABCDEF"
    grid = np.round((points - origin) / scale).astype(int)
    times, strengths = _cycled(TIMES, points), _cycled(INTENSITY, points)
    wide = colors.astype(int) * (257 if bits == 16 else 1)
    for k in range(n):
        kind = classes[k] if k < len(classes) else 2
        row = struct.pack("<3iH", *grid[k], int(strengths[k]))
        if format <= 5:
            row += struct.pack("<BBbBH", 0, kind, 0, 0, 0)
        else:
            row += struct.pack("<BBBBhH", 0, 4 * (kind >> 7), kind & 127, 0, 0, 0)
        row += struct.pack("<d", times[k]) if format in TIMED else b""
        row += struct.pack("<3H", *wide[k]) if format in COLORED else b""
        body += row + bytes(stride - len(row))
    return head + body + tail


def _cycled(values: Float64, points: Float64) -> Float64:
    return np.resize(values, len(points))
