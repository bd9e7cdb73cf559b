"""PLY against plyfile, and every variant met in the wild."""

from __future__ import annotations

import io

import numpy as np
import numpy.typing as npt
import plyfile
import pytest

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats import encode_model, read_model
from engine.formats.ply.gaussians import read_ply, write_ply
from engine.model import DISC_THICKNESS, GaussianModel
from tests.formats.models import ATTRIBUTES, DATA, assert_same, header_for, names_of, ply_of, random_model, rows_for

TRAIN = DATA / "train_1000.ply"


def fields(model: GaussianModel) -> dict[str, npt.NDArray[np.float32]]:
    """What INRIA's property names mean, spelled out: the specification of reader and writer."""
    values = {name: model.means[:, i] for i, name in enumerate("xyz")}
    values |= {f"scale_{i}": model.log_scales[:, i] for i in range(3)}
    values |= {f"rot_{i}": model.quats[:, i] for i in range(4)}
    values |= {f"f_dc_{i}": model.sh[:, 0, i] for i in range(3)}
    coefficients = model.sh.shape[1] - 1
    for i in range(3 * coefficients):
        values[f"f_rest_{i}"] = model.sh[:, 1 + i % coefficients, i // coefficients]
    return {**values, "opacity": model.opacity_logits}


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("n", [1, 255, 5000])
def test_round_trip_keeps_every_bit(degree: int, n: int) -> None:
    model = random_model(degree, n)
    loaded = read_model(encode_model(model, "ply"))
    assert_same(loaded.model, model)
    assert loaded.repairs == ()
    assert loaded.format == "ply"


def test_a_file_of_inria_is_written_back_byte_for_byte() -> None:
    data = TRAIN.read_bytes()
    records = plyfile.PlyData.read(io.BytesIO(data))["vertex"].data
    quats = np.stack([records[f"rot_{i}"] for i in range(4)], axis=1)
    written = b"".join(write_ply(read_ply(data, file="train")[0].with_(quats=quats)))
    assert written == data


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_plyfile_reads_what_is_written(degree: int) -> None:
    model = random_model(degree)
    records = plyfile.PlyData.read(io.BytesIO(encode_model(model, "ply")))["vertex"].data
    expected = fields(model)
    assert set(records.dtype.names) == {*expected, "nx", "ny", "nz"}
    for name, values in expected.items():
        np.testing.assert_array_equal(records[name], values, err_msg=name)


@pytest.mark.parametrize(("text", "byte_order"), [(False, "<"), (False, ">"), (True, "=")])
@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_reads_what_plyfile_writes(text: bool, byte_order: str, kind: str) -> None:
    model = random_model(2, 5000 if text else 300)
    values = fields(model)
    table = np.empty(len(model), dtype=[(name, kind) for name in reversed(values)])  # the order is free
    for name, column in values.items():
        table[name] = column
    stream = io.BytesIO()
    element = plyfile.PlyElement.describe(table, "vertex", comments=["f\u00fcr".encode("ascii", "ignore").decode()])
    plyfile.PlyData([element], text=text, byte_order=byte_order).write(stream)
    loaded = read_model(stream.getvalue())
    for name in ATTRIBUTES:  # plyfile prints 18 digits, so the text is exact as well
        np.testing.assert_array_equal(getattr(loaded.model, name), getattr(model, name), err_msg=name)


def test_two_scales_become_thin_discs() -> None:
    names = names_of(1, scales=2)
    rows = rows_for(names, 50)
    loaded = read_model(ply_of(names, rows))
    in_plane = rows[:, [names.index("scale_0"), names.index("scale_1")]]
    np.testing.assert_array_equal(loaded.model.log_scales[:, :2], in_plane)
    expected = in_plane.min(axis=1) + np.log(DISC_THICKNESS)
    np.testing.assert_allclose(loaded.model.log_scales[:, 2], expected, rtol=1e-6)
    assert "flat_discs" in [repair.code for repair in loaded.repairs]
    assert loaded.model.is_flat


def test_discs_are_written_with_two_scales() -> None:
    names = names_of(1, scales=2)
    discs = read_model(ply_of(names, rows_for(names, 50))).model
    written = encode_model(discs, "ply")
    records = plyfile.PlyData.read(io.BytesIO(written))["vertex"].data
    assert [name for name in records.dtype.names if name.startswith("scale")] == ["scale_0", "scale_1"]
    assert_same(read_model(written).model, discs)
    thick = discs.with_(log_scales=discs.log_scales + np.float32([0, 0, 13]))
    assert b"scale_2" in encode_model(thick, "ply")


def test_raw_quaternions_are_normalized() -> None:
    """DreamGaussian writes them of any length."""
    names = names_of(0, normals=True)
    rows = rows_for(names, 50)
    raw = 7 * rows[:, -4:].astype(np.float64)
    rows[:, -4:] = raw
    loaded = read_model(ply_of(names, rows))
    expected = raw / np.linalg.norm(raw, axis=1, keepdims=True)
    np.testing.assert_allclose(loaded.model.quats, expected, atol=1e-6)
    assert [repair.code for repair in loaded.repairs] == ["quaternions_normalized"]


def test_extra_properties_and_elements_are_ignored_and_reported() -> None:
    names = names_of(0)
    rows = rows_for(names, 20)
    plain = read_model(ply_of(names, rows)).model
    wide = np.column_stack([np.full(20, 9), rows, np.full(20, 9)])
    head = ["ply", "format binary_little_endian 1.0", "comment \u00fc", "element frame 2", "property int number"]
    head += ["element vertex 20", "property float mip", *(f"property float {name}" for name in names)]
    head += ["property float id", "element face 1", "property list uchar int corners", "end_header", ""]
    body = b"\0" * 8 + wide.astype("<f4").tobytes() + b"\x03" + b"\0" * 12
    loaded = read_model("\n".join(head).encode() + body)
    assert_same(loaded.model, plain)
    counts = {repair.code: repair.count for repair in loaded.repairs}
    assert counts["extra_properties"] == 2
    assert counts["extra_elements"] == 2


def test_windows_line_ends_in_the_header() -> None:
    names = names_of(0)
    rows = rows_for(names, 3)
    data = header_for(names, 3).replace(b"\n", b"\r\n") + rows.tobytes()
    assert_same(read_model(data).model, read_model(ply_of(names, rows)).model)


@pytest.mark.parametrize("byte_order", ["little", "big"])
def test_a_file_of_no_gaussians_is_refused(byte_order: str) -> None:
    whole = encode_model(random_model(0, 1), "ply").split(b"end_header\n")[0] + b"end_header\n"
    empty = whole.replace(b"vertex 1\n", b"vertex 0\n").replace(b"little", byte_order.encode())
    with pytest.raises(FormatError, match="no Gaussians"):
        read_model(empty)


def test_a_point_cloud_is_told_as_such() -> None:
    names = ["x", "y", "z", "red", "green", "blue"]
    with pytest.raises(UnsupportedFormatError, match="colored point cloud, not a Gaussian model"):
        read_model(ply_of(names, rows_for(names, 4)), name="points.ply")
    names = ["x", "y", "z", "f_offset_0", "f_anchor_feat_0", "opacity", "scale_0", "rot_0"]
    with pytest.raises(UnsupportedFormatError, match=r"anchors of a neural model.*export plain Gaussians"):
        read_model(ply_of(names, rows_for(names, 4)))


@pytest.mark.parametrize("name", [name for name in names_of(1) if name not in ("scale_2", "f_dc_0")])
def test_a_missing_property_is_named(name: str) -> None:
    names = [other for other in names_of(1) if other != name]
    with pytest.raises(FormatError) as caught:
        read_model(ply_of(names, rows_for(names, 4)), name="scene.ply")
    assert caught.value.element == "vertex"
    if not name.startswith("f_rest"):  # there, the count is what is wrong
        assert caught.value.prop == name
    assert str(caught.value).startswith("scene.ply, element 'vertex'")


def test_a_gap_in_f_rest_is_named() -> None:
    names = [name if name != "f_rest_4" else "f_rest_9" for name in names_of(1)]
    with pytest.raises(FormatError) as caught:
        read_model(ply_of(names, rows_for(names, 4)))
    assert caught.value.prop == "f_rest_4"


@pytest.mark.parametrize(
    ("count", "element", "row"), [("11", "vertex", 10), ("9", "vertex", None), ("99999999999999", "vertex", 10)]
)
def test_a_wrong_count_is_refused_before_anything_is_allocated(count: str, element: str, row: int | None) -> None:
    names = names_of(0)
    with pytest.raises(FormatError, match="count is wrong") as caught:
        read_model(ply_of(names, rows_for(names, 10), count=count), name="lie.ply")
    assert (caught.value.file, caught.value.element, caught.value.row) == ("lie.ply", element, row)


def test_a_cut_off_file_names_the_first_row_that_is_not_whole() -> None:
    names = names_of(0)
    data = ply_of(names, rows_for(names, 10))
    with pytest.raises(FormatError, match="cut off") as caught:
        read_model(data[: -4 * len(names) - 1])
    assert caught.value.row == 8


def ascii_file(names: list[str], lines: list[str], count: int) -> bytes:
    return header_for(names, count, "ascii") + ("\n".join(lines) + "\n").encode()


def test_faults_of_an_ascii_file_are_named() -> None:
    names = names_of(0)
    good = " ".join("1.25" for _ in names)
    word = " ".join("1.25" if name != "f_dc_2" else "red" for name in names)
    for lines, count, row, prop in (
        ([good, word], 2, 1, "f_dc_2"),
        ([good, good[:-5]], 2, 1, None),
        ([good, good, ""], 3, 2, None),
        ([good], 2, 1, None),
        ([good] * 4097 + [word], 4098, 4097, "f_dc_2"),
    ):
        with pytest.raises(FormatError) as caught:
            read_model(ascii_file(names, lines, count), name="text.ply")
        assert (caught.value.element, caught.value.row, caught.value.prop) == ("vertex", row, prop)
    with pytest.raises(FormatError, match="more lines follow"):
        read_model(ascii_file(names, [good, good], 1))
    with pytest.raises(FormatError, match="99999999999 rows"):
        read_model(ascii_file(names, [good], 99999999999))


def test_ascii_with_elements_around_and_values_that_are_no_numbers() -> None:
    names = names_of(0)
    good = " ".join("0.5" for _ in names)
    head = ["ply", "format ascii 1.0", "element frame 1", "property int a", "element vertex 3"]
    head += [*(f"property float {name}" for name in names), "element face 1", "property list uchar int c"]
    bad = good.replace("0.5", "nan", 1)
    text = "\n".join([*head, "end_header", "7", good, bad, "  " + good + " ", "3 0 1 2", ""])
    loaded = read_model(text.encode())
    assert len(loaded.model) == 2
    assert {r.code: r.count for r in loaded.repairs}["rows_dropped"] == 1
