"""Colored corners of a mesh as Wavefront OBJ: colors at the corners, or of a texture in a file beside it."""

import io
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np
import numpy.typing as npt

from engine.errors import FormatError
from engine.formats.guards import beside, read_small
from engine.formats.textures import Textures
from engine.model import Float32

_LINE = 1 << 16
"""Bytes that are looked at of a line: faces of a few thousand corners."""


def read_obj(data: bytes, folder: Path | None, *, file: str) -> tuple[Float32, Float32] | None:
    """Places and colors (0 to 1, or to 255), (N, 3) each; None where it has no colors, or no corners.

    Colors are those of lines ``v x y z red green blue``, as MeshLab and CloudCompare write them. Without, and with a
    `folder`, they are those of ``map_Kd`` in the files of materials that it names; a corner has that of the first face
    with it, and corners without are left out. FormatError where such a file is missing or damaged.
    """
    colored = _table(data, b"v", 6)
    if colored is not None:
        return colored[:, :3].copy(), colored[:, 3:]
    corners, at = _table(data, b"v", 3), _table(data, b"vt", 2)
    if corners is None or at is None or folder is None:
        return None
    if not (maps := _maps(data, folder, file)):
        return None
    owner, coordinate = _first_uses(data, len(corners), len(at), list(maps), file)
    colors, seen, textures = np.zeros((len(corners), 3), np.float32), np.zeros(len(corners), np.bool_), Textures(file)
    for number, path in enumerate(maps.values()):
        rows = np.flatnonzero(owner == number)
        if len(rows):
            colors[rows] = textures.sample(path, at[coordinate[rows]] * [1, -1] + [0, 1])  # v goes up
            seen[rows] = True
    return (corners[seen], colors[seen]) if seen.any() else None


def _lines(data: bytes, *starts: bytes) -> Iterator[bytes]:
    starts = tuple(start + space for start in starts for space in (b" ", b"\t"))
    return (line[:_LINE] for line in io.BytesIO(data) if line.startswith(starts))


def _table(data: bytes, start: bytes, columns: int) -> Float32 | None:
    """The first numbers of all lines of a kind; None where there are none, or one has fewer."""
    lines = _lines(data, start)
    first = next(lines, None)
    if first is None:
        return None
    try:  # line after line: the words of a whole file take ten times its bytes
        return np.loadtxt(chain([first], lines), np.float32, usecols=range(1, columns + 1), ndmin=2, comments=None)
    except ValueError:
        return None


def _maps(data: bytes, folder: Path, file: str) -> dict[str, Path]:
    """The picture of each material that has one, by its name."""
    found: dict[str, Path] = {}
    for library in {_rest(line) for line in _lines(data, b"mtllib")}:
        name = ""
        for line in read_small(beside(folder, library, file)).splitlines():
            keyword = line.split(maxsplit=1)[0] if line.strip() else b""
            if keyword == b"newmtl":
                name = _rest(line)
            elif keyword.lower() == b"map_kd":
                rest = _rest(line)
                found[name] = beside(folder, rest.split()[-1] if rest.startswith("-") else rest, file)
    return found


def _rest(line: bytes) -> str:
    words = line.strip().split(maxsplit=1)
    return words[1].decode("utf-8", "replace").strip('"') if len(words) > 1 else ""


def _first_uses(
    data: bytes, corners: int, coordinates: int, materials: list[str], file: str
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int64]]:
    """(corners,) number of the material, and row of the texture coordinate, of the first face that uses a corner with
    both; -1 where there is none."""
    owner, coordinate = np.full(corners, -1, np.int32), np.zeros(corners, np.int64)
    current = 0 if len(materials) == 1 else -1
    for line in _lines(data, b"usemtl", b"f"):
        if line.startswith(b"usemtl"):
            current = materials.index(name) if (name := _rest(line)) in materials else -1
            continue
        for word in line.split()[1:] if current >= 0 else ():
            try:
                corner, at = (int(each) for each in word.split(b"/")[:2])
            except ValueError:  # no coordinate
                continue
            row, at = corner - 1 if corner > 0 else corners + corner, at - 1 if at > 0 else coordinates + at
            if not (0 <= row < corners and 0 <= at < coordinates):
                raise FormatError(f"a face names {word[:40].decode('latin-1')!a}, which is not there", file=file)
            if owner[row] < 0:
                owner[row], coordinate[row] = current, at
    return owner, coordinate
