"""PLY as other programs write it, and as nobody should: read as what it is, or refused by what is wrong."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from engine.errors import FormatError
from engine.formats import read_model

DATA = (Path(__file__).parents[1] / "data" / "train_1000.ply").read_bytes()
BODY = DATA.split(b"end_header\n", 1)[1]
HEAD = DATA[: -len(BODY)]
NAMES = [line.split()[2] for line in HEAD.decode().splitlines() if line.startswith("property")]
ROWS = np.frombuffer(BODY, np.dtype([(name, "<f4") for name in NAMES]))
KINDS = {"f2": "half", "f4": "float", "f8": "double"}


def written(code: str = "<f4", names: list[str] = NAMES, more: str = "", form: str = "") -> bytes:
    rows = np.empty(len(ROWS), [(name, code) for name in names])
    for name in names:
        rows[name] = ROWS[name]
    form = form or ("binary_big_endian" if code[0] == ">" else "binary_little_endian")
    lines = ["ply", f"format {form} 1.0", *filter(None, [more]), f"element vertex {len(rows)}"]
    head = "\n".join([*lines, *(f"property {KINDS[code[1:]]} {name}" for name in names), "end_header", ""]).encode()
    text = "".join(" ".join(f"{value:.8E}" for value in row) + "\n" for row in rows.tolist()) if form == "ascii" else ""
    return head + (text.encode() or rows.tobytes())


def windows(data: bytes) -> bytes:
    head, body = data.split(b"end_header\n", 1)
    return (head + b"end_header\n").replace(b"\n", b"\r\n") + body


FACE = b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"
SAME = {
    "doubles": written("<f8"),
    "half floats": written("<f2"),
    "big endian": written(">f4"),
    "big endian doubles": written(">f8"),
    "no normals": written(names=[name for name in NAMES if name[0] != "n"]),
    "umlauts in a comment and lines of Windows": windows(written(more="comment gr\u00fcn \u00e0 la carte")),
    "exponents": written(form="ascii"),
    "exponents, lines of Windows, and an empty one": written(form="ascii").replace(b"\n", b"\r\n") + b"\r\n",
    "a face": HEAD.replace(b"end_header\n", FACE) + BODY + struct.pack("<B3i", 3, 0, 1, 2),
}


@pytest.mark.parametrize("name", SAME)
def test_what_is_meant_is_read(name: str) -> None:
    model = read_model(SAME[name]).model
    rounding = 2e-3 if name == "half floats" else 1e-6
    for array, column in (
        (model.means[:, 0], "x"),
        (model.log_scales[:, 2], "scale_2"),
        (model.sh[:, 15, 2], "f_rest_44"),
    ):
        np.testing.assert_allclose(array, ROWS[column], rtol=rounding, atol=rounding)


def with_list() -> bytes:
    step = ROWS.dtype.itemsize
    extra = (b"\x01\0\0\0\0", b"\0")  # one value and none, in turns
    rows = (BODY[i : i + step] + extra[i // step % 2] for i in range(0, len(BODY), step))
    return HEAD.replace(b"end_header\n", b"property list uchar float extra\nend_header\n") + b"".join(rows)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (HEAD.replace(b"vertex 1000", b"vertex 0"), "no Gaussians"),
        (DATA.replace(b"vertex 1000", b"vertex 999", 1), "bytes follow the 999 rows"),
        (DATA.replace(b"vertex 1000", b"vertex 1001", 1), "cut off, or the count is wrong"),
        (with_list(), "lists of different lengths"),
        (written(form="ascii").replace(b"E", b"D"), "is no float32"),
        (written(names=[name for name in NAMES if name not in ("f_rest_43", "f_rest_44")]), "43 properties f_rest"),
    ],
)
def test_what_is_wrong_is_named(data: bytes, message: str) -> None:
    with pytest.raises(FormatError, match=message):
        read_model(data)


def test_strays_beyond_belief_are_left_out_by_row() -> None:
    rows = ROWS.copy()
    rows["x"][5], rows["y"][9] = 1e30, np.nan
    loaded = read_model(HEAD + rows.tobytes())
    (dropped,) = (each for each in loaded.repairs if each.code == "rows_dropped")
    assert (len(loaded.model), dropped.count, "first in row 5" in dropped.text) == (998, 2, True)
