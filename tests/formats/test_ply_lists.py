"""Lists before or among the Gaussians, and old line ends: rows stay those of the file."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats import encode_model, read_model
from tests.formats.models import assert_same, names_of, ply_of, rows_for

NAMES = names_of(1)
ROWS = rows_for(NAMES, 30)
PLAIN = ply_of(NAMES, ROWS)
MODEL = read_model(PLAIN).model
HEAD, BODY = PLAIN.split(b"end_header\n")
FACES = b"element face 4\nproperty uchar kind\nproperty list uchar int vertex_indices\n"


def text_of(rows: Any) -> bytes:
    return "\n".join(" ".join(str(x) for x in row) for row in rows).encode() + b"\n"


def with_faces(lengths: list[int], order: str = "<") -> bytes:
    """Faces of so many corners before the Gaussians; as text where there is no order."""
    head = HEAD.replace(b"element vertex", FACES + b"element vertex")
    if not order:
        lines = text_of([[7, n, *range(n)] for n in lengths])
        return head.replace(b"binary_little_endian", b"ascii") + b"end_header\n" + lines + text_of(ROWS)
    faces = b"".join(struct.pack(f"{order}BB{n}i", 7, n, *range(n)) for n in lengths)
    name = b"binary_big_endian" if order == ">" else b"binary_little_endian"
    rows = ROWS.astype(order + "f4").tobytes()
    return head.replace(b"binary_little_endian", name) + b"end_header\n" + faces + rows


@pytest.mark.parametrize("order", ["<", ">", ""])
def test_faces_before_the_gaussians_are_passed_over(order: str) -> None:
    loaded = read_model(with_faces([3, 3, 3, 3], order))
    assert_same(loaded.model, MODEL)
    assert "extra_elements" in [each.code for each in loaded.repairs]


@pytest.mark.parametrize("order", ["<", ">", ""])
def test_faces_of_several_lengths_are_passed_over(order: str) -> None:
    assert_same(read_model(with_faces([3, 4, 70, 0], order)).model, MODEL)


def test_gaussians_whose_lists_differ_are_refused() -> None:
    head = HEAD.replace(b"property float opacity", b"property float opacity\nproperty list uchar short tags")
    rows = b"".join(row.tobytes() + struct.pack(f"<B{k % 3}h", k % 3, *range(k % 3)) for k, row in enumerate(ROWS))
    with pytest.raises(FormatError, match="'tags': lists of different lengths"):
        read_model(head + b"end_header\n" + rows)


@pytest.mark.parametrize("text", [False, True])
def test_lists_among_the_properties_are_carried(text: bool) -> None:
    head = HEAD.replace(b"property float opacity", b"property list uchar short tags\nproperty float opacity")
    at = NAMES.index("opacity")
    if text:
        lines = [[*row[:at], 2, i, -i, *row[at:]] for i, row in enumerate(ROWS.tolist())]
        data = head.replace(b"binary_little_endian", b"ascii") + b"end_header\n" + text_of(lines)
    else:
        rows = [row[:at].tobytes() + struct.pack("<Bhh", 2, i, -i) + row[at:].tobytes() for i, row in enumerate(ROWS)]
        data = head + b"end_header\n" + b"".join(rows)
    model = read_model(data).model
    np.testing.assert_array_equal(model.opacity_logits, MODEL.opacity_logits)
    again = read_model(encode_model(model, "ply")).model
    for each in (model, again):
        assert each.carried is not None
        assert each.carried.names == ("tags", "tags[0]", "tags[1]")
        np.testing.assert_array_equal(each.carried.columns["tags[1]"], -np.arange(30))


@pytest.mark.parametrize("end", [b"\r\n", b"\r"])
def test_other_ends_of_lines(end: bytes) -> None:
    assert_same(read_model(HEAD.replace(b"\n", end) + b"end_header" + end + BODY).model, MODEL)
    text = HEAD.replace(b"binary_little_endian", b"ascii") + b"end_header\n" + text_of(ROWS)
    assert_same(read_model(text.replace(b"\n", end)).model, MODEL)


@pytest.mark.parametrize("change", [lambda d: b"\xef\xbb\xbf" + d, lambda d: b"PLY" + d[3:], lambda d: b"ply " + d[3:]])
def test_a_first_line_that_an_editor_changed_is_named(change: Any) -> None:
    with pytest.raises(UnsupportedFormatError, match=r"begins like a PLY.*export it again"):
        read_model(change(PLAIN))


@pytest.mark.parametrize("cut", [1, 40, len(with_faces([3] * 4)) - len(HEAD) - len(FACES) - 12])
def test_a_cut_stays_an_error_of_ours(cut: int) -> None:
    with pytest.raises(FormatError):
        read_model(with_faces([3] * 4)[:-cut])


def test_a_list_that_claims_billions_is_refused() -> None:
    head = HEAD.replace(b"element vertex", FACES.replace(b"uchar int", b"uint int") + b"element vertex")
    with pytest.raises(FormatError, match="is cut off, or the length of a list is wrong"):
        read_model(head + b"end_header\n" + b"\7\xff\xff\xff\xff" + bytes(48) + BODY)
    many = HEAD.replace(b"element vertex", b"element face 20000000\nproperty list uchar int i\nelement vertex")
    with pytest.raises(FormatError, match="20000000 rows with lists of different lengths"):
        read_model(many + b"end_header\n\1" + bytes(20_000_010) + BODY)
