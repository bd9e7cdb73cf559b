"""A Gaussian PLY as other programs write it gives the values that it was made from, and says what was translated."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.errors import FormatError, UnsupportedFormatError
from engine.formats import LoadedModel, encode_model, read_model, write_model
from engine.formats.file_writing import loss_note
from engine.model import SH_C0, look_at
from tests.formats.damage import assert_valid
from tests.formats.models import names_of, random_model

CODES = {"ushort": "u2", "uint16": "u2", "short": "i2", "int16": "i2", "half": "f2"} | {
    "uchar": "u1", "char": "i1", "int": "i4", "uint": "u4", "float": "f4", "double": "f8"
}  # fmt: skip


def file_of(columns: dict[str, tuple[str, npt.NDArray[np.generic]]], order: str = "<", ascii: bool = False) -> bytes:
    """A PLY of columns (type, values), which are cast; in ASCII or of that byte order."""
    count = len(next(iter(columns.values()))[1])
    encoding = "ascii" if ascii else {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    lines = ["ply", f"format {encoding} 1.0", f"element vertex {count}"]
    lines += [*(f"property {kind} {name}" for name, (kind, _) in columns.items()), "end_header", ""]
    table = np.empty(count, np.dtype([(name, order + CODES[kind]) for name, (kind, _) in columns.items()]))
    for name, (_, values) in columns.items():
        table[name] = values
    body = "\n".join(" ".join(map(str, row)) for row in table.tolist()).encode() if ascii else table.tobytes()
    return "\n".join(lines).encode() + body


def floats(degree: int = 0, n: int = 300) -> dict[str, tuple[str, npt.NDArray[np.generic]]]:
    """The columns of a random model under INRIA's names."""
    model = random_model(degree, n)
    columns = [*model.means.T, *model.sh[:, 0].T, *model.sh[:, 1:].transpose(0, 2, 1).reshape(n, -1).T]
    columns += [model.opacity_logits, *model.log_scales.T, *model.quats.T]
    return {name: ("float", column) for name, column in zip(names_of(degree), columns, strict=True)}


def codes(loaded: LoadedModel) -> set[str]:
    return {repair.code for repair in loaded.repairs} - {"quaternions_normalized"}


@pytest.mark.parametrize("kind", ["ushort", "uint16", "short", "int16", "half"])
@pytest.mark.parametrize(("order", "ascii"), [("<", False), (">", False), ("<", True)])
def test_half_floats_are_read_whatever_integers_they_are_called(kind: str, order: str, ascii: bool) -> None:
    if ascii and kind == "half":
        pytest.skip("text holds no bits")
    columns = floats(degree=1)
    halves = {name: values.astype(np.float16) for name, (_, values) in columns.items()}
    stored = {name: (kind, half.view(CODES[kind])) for name, half in halves.items()}
    loaded = read_model(file_of(stored, order, ascii))
    assert codes(loaded) == ({"half_floats"} if kind != "half" else set())
    for axis, name in enumerate("xyz"):
        np.testing.assert_array_equal(loaded.model.means[:, axis], halves[name].astype(np.float32))
    np.testing.assert_array_equal(loaded.model.opacity_logits, halves["opacity"].astype(np.float32))
    np.testing.assert_array_equal(loaded.model.sh[:, 3, 2], halves["f_rest_8"].astype(np.float32))


def test_half_floats_stand_beside_floats() -> None:
    columns = floats()
    for name in ("x", "y", "z", "scale_1"):
        columns[name] = ("ushort", columns[name][1].astype(np.float16).view(np.uint16))
    loaded = read_model(file_of(columns))
    assert codes(loaded) == {"half_floats"}
    np.testing.assert_array_equal(loaded.model.means, random_model(0, 300).means.astype(np.float16).astype(np.float32))


@pytest.mark.parametrize("kind", ["uchar", "char", "short", "ushort", "int", "uint"])
@pytest.mark.parametrize("names", [["opacity"], ["x", "y", "z"], ["rot_0"], ["scale_0", "scale_1", "scale_2"]])
def test_whole_numbers_are_refused_by_name(kind: str, names: list[str]) -> None:
    columns = floats()
    columns |= {name: (kind, np.arange(len(columns["x"][1])) % 100) for name in names}
    with pytest.raises(FormatError, match=rf"property '{names[0]}': is {kind}.*export it as float"):
        read_model(file_of(columns))


def test_doubles_beyond_float32_are_left_out_and_rounded_ones_told() -> None:
    columns = floats()
    far = columns["x"][1].astype(np.float64)
    far[7] = 1e300
    loaded = read_model(file_of(columns | {"x": ("double", far)}))
    assert (codes(loaded), len(loaded.model)) == ({"rows_dropped"}, 299)
    np.testing.assert_array_equal(loaded.model.means[:, 0], np.delete(columns["x"][1], 7))


def test_map_coordinates_keep_their_precision(tmp_path: Path) -> None:
    """UTM: 4e5 east, 5e6 north. float32 would round the north to half a unit."""
    columns = floats()
    places = {"x": 448_123.456, "y": 5_412_345.678, "z": 312.5}
    exact = {axis: columns[axis][1].astype(np.float64) + at for axis, at in places.items()}
    small = {f"scale_{axis}": ("float", np.full(300, np.log(0.01))) for axis in range(3)}
    (tmp_path / "utm.ply").write_bytes(file_of(columns | small | {k: ("double", v) for k, v in exact.items()}))
    loaded = read_model(tmp_path / "utm.ply")
    model, wanted = loaded.model, np.stack(list(exact.values()), axis=1)
    assert codes(loaded) == {"origin_moved"}
    np.testing.assert_allclose(model.means + np.array(model.origin), wanted, rtol=0, atol=1e-6)
    assert np.abs(model.means).max() < 20
    write_model(model.take(np.arange(0, 300, 2)), tmp_path / "back.ply")
    back = read_model(tmp_path / "back.ply").model
    np.testing.assert_allclose(back.means + np.array(back.origin), wanted[::2], rtol=0, atol=1e-6)
    (note,) = [note for note in loss_note(model, "spz") if "map coordinates" in note]
    assert "5412" in note
    assert "0.25" in note, "half of float32's step at 5e6"
    assert not loss_note(model, "ply")


def test_map_coordinates_in_single_precision_are_told() -> None:
    columns = floats()
    small = {f"scale_{axis}": ("float", np.full(300, np.log(0.01))) for axis in range(3)}
    assert codes(read_model(file_of(columns | small))) == set()
    far = columns["y"][1].astype(np.float64) + 5_412_345.678
    assert codes(read_model(file_of(columns | small | {"y": ("float", far)}))) == {"centers_coarse"}


def test_doubles_that_no_origin_helps_are_told() -> None:
    columns = floats()
    small = {f"scale_{axis}": ("float", np.full(300, np.log(1e-9))) for axis in range(3)}
    fine = columns["x"][1].astype(np.float64) + 1e-9
    loaded = read_model(file_of(columns | small | {"x": ("double", fine)}))
    (reported,) = [repair for repair in loaded.repairs if repair.code == "centers_rounded"]
    error = np.abs(fine - fine.astype(np.float32))
    assert reported.count == np.count_nonzero(error > 1e-9 / 20) > 100
    assert loaded.model.origin == (0, 0, 0)


def test_a_camera_of_a_map_sees_what_it_sees_from_the_origin() -> None:
    camera = look_at((3, 2, 1), (0, 0, 0), (0, 0, 1), 60.0, 64, 48)
    far = look_at((4e5 + 3, 5e6 + 2, 1), (4e5, 5e6, 0), (0, 0, 1), 60.0, 64, 48)
    np.testing.assert_allclose(far.relative_to((4e5, 5e6, 0)).viewmat, camera.viewmat, atol=1e-8)


@pytest.mark.parametrize("prefix", ["scalar_", "sf_", "Scalar_"])
def test_a_prefix_of_the_names_is_dropped(prefix: str) -> None:
    columns = floats(degree=1)
    renamed = {name if name in "xyz" else prefix + name: column for name, column in columns.items()}
    whole = {prefix + name: column for name, column in columns.items()}
    gray = {name: ("uchar", np.full(300, 9)) for name in ("red", "green", "blue")}
    plain = read_model(file_of(columns)).model
    for stored, reported in (
        (renamed, {"names_prefixed"}),
        (whole, {"names_prefixed"}),
        (renamed | gray, {"names_prefixed", "extra_properties"}),
    ):
        loaded = read_model(file_of(stored))
        assert codes(loaded) == reported
        np.testing.assert_array_equal(loaded.model.sh, plain.sh)
        np.testing.assert_array_equal(loaded.model.means, plain.means)


@pytest.mark.parametrize(
    ("kind", "full"),
    [("uchar", 255), ("int", 255), ("ushort", 255), ("ushort", 65535), ("float", 1), ("float", 255), ("double", 1)],
)
@pytest.mark.parametrize("names", [("red", "green", "blue"), ("r", "g", "b")])
def test_colors_stand_for_the_first_coefficients(kind: str, full: int, names: tuple[str, ...]) -> None:
    columns = {name: column for name, column in floats().items() if not name.startswith("f_dc")}
    shares = np.linspace(0, 1, 300)
    given = np.rint(shares * full) if full > 1 else shares
    loaded = read_model(file_of(columns | dict.fromkeys(names, (kind, given))))
    assert codes(loaded) == {"colors_read"}
    np.testing.assert_allclose(0.5 + SH_C0 * loaded.model.sh[:, 0], np.tile(given[:, None] / full, 3), atol=1e-6)


def test_a_point_cloud_with_colors_stays_one() -> None:
    columns = {name: ("float", np.zeros(9)) for name in "xyz"} | {
        c: ("uchar", np.zeros(9)) for c in ("red", "green", "blue")
    }
    with pytest.raises(UnsupportedFormatError, match="colored point cloud"):
        read_model(file_of(columns))


def test_degree_four_is_read_to_degree_three() -> None:
    columns = floats(degree=3)
    rest = {f"f_rest_{24 * c + k}": ("float", np.full(300, 100.0 * c + k)) for c in range(3) for k in range(24)}
    loaded = read_model(file_of({**{n: v for n, v in columns.items() if "rest" not in n}, **rest}))
    assert codes(loaded) == {"degree_dropped"}
    expected = 100.0 * np.arange(3) + np.arange(15)[:, None]  # (15, 3)
    np.testing.assert_array_equal(loaded.model.sh[:, 1:], np.broadcast_to(expected, (300, 15, 3)))


def test_activated_values_are_hinted_at_and_kept() -> None:
    model = random_model(0, 300)
    columns = floats()
    columns |= {f"scale_{axis}": ("float", 0.001 + 0.1 * model.opacities) for axis in range(3)}
    columns |= {"opacity": ("float", model.opacities)}
    loaded = read_model(file_of(columns))
    assert codes(loaded) == {"scales_activated", "opacities_activated"}
    np.testing.assert_array_equal(loaded.model.opacity_logits, model.opacities)
    assert codes(read_model(encode_model(model, "ply"))) == set()


@pytest.mark.parametrize("most", [1, 255])
def test_colors_and_opacities_in_the_range_of_a_screen_are_hinted_at(most: int) -> None:
    model = random_model(0, 300)
    columns = floats()
    shown = {f"f_dc_{c}": ("float", most * (0.1 + 0.8 * model.opacities)) for c in range(3)}
    assert codes(read_model(file_of({**columns, **shown}))) == {"colors_activated"}
    loaded = read_model(file_of({**columns, "opacity": ("float", most * model.opacities)}))
    assert "opacities_activated" in codes(loaded)
    assert f"0 to {most}" in next(each.text for each in loaded.repairs if each.code == "opacities_activated")


def test_names_in_another_case_are_read() -> None:
    columns = floats()
    loaded = read_model(file_of({name.upper(): column for name, column in columns.items()}))
    assert codes(loaded) == {"names_lowered"}
    np.testing.assert_array_equal(loaded.model.means, read_model(file_of(columns)).model.means)
    twice = {"X": ("float", columns["x"][1])}  # both cases: it is a property of its own
    assert codes(read_model(file_of({**columns, **twice}))) == {"extra_properties"}


@pytest.mark.parametrize(
    ("old", "new"), [("scale_0", "size_x"), ("rot_0", "quat_w"), ("opacity", "alpha"), ("x", "position_x")]
)
def test_what_is_missing_is_said_with_what_is_there(old: str, new: str) -> None:
    renamed = {new if name == old else name: column for name, column in floats().items()}
    with pytest.raises(FormatError, match=rf"'{old}': is missing; not known here: '{new}'"):
        read_model(file_of(renamed))


def test_coordinates_of_a_texture_are_no_motion() -> None:
    places = {name: ("float", np.arange(9.0)) for name in ("x", "y", "z", "s", "t")}
    with pytest.raises(UnsupportedFormatError, match="point cloud or a mesh"):
        read_model(file_of(places))
    with pytest.raises(UnsupportedFormatError, match="point cloud or a mesh"):  # of a laser scanner
        read_model(file_of({**places, "time": places["t"]}))
    values = floats()
    extra = dict.fromkeys(("s", "t"), values["x"])
    assert codes(read_model(file_of({**values, **extra}))) == {"extra_properties"}


@pytest.mark.parametrize(("tail", "is_read"), [(b"\n", True), (b"\r\n", True), (b"\n\n", False), (b"\0", False)])
def test_one_line_end_may_follow_the_rows(tail: bytes, is_read: bool) -> None:
    data = file_of(floats())
    if is_read:
        np.testing.assert_array_equal(read_model(data + tail).model.means, read_model(data).model.means)
    else:
        with pytest.raises(FormatError, match="bytes follow"):
            read_model(data + tail)


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_any_types_and_bits_give_a_sound_model_or_a_named_fault(data: st.DataObject) -> None:
    names = [*names_of(1), "red", "green", "blue"]
    common = data.draw(st.sampled_from(sorted(CODES)))
    types = {name: data.draw(st.sampled_from([common] * 9 + sorted(CODES))) for name in names}
    left_out = data.draw(st.sets(st.sampled_from(names), max_size=4))
    prefix, order = data.draw(st.sampled_from(["", "scalar_"])), data.draw(st.sampled_from("<>"))
    bits = np.random.default_rng(data.draw(st.integers(0, 1000)))
    columns = {}
    for name in [name for name in names if name not in left_out]:
        code = np.dtype(CODES[types[name]])
        sound = (
            bits.normal(size=9).astype(np.float16).view(np.uint16) if code.str[1:] in ("u2", "i2") else bits.random(9)
        )
        columns[prefix + name] = (
            types[name],
            sound if bits.random() < 0.8 else np.frombuffer(bits.bytes(9 * code.itemsize), code),
        )
    fault = "any.ply"
    try:
        with np.errstate(over="raise", invalid="raise", divide="raise"):
            assert_valid(read_model(file_of(columns, order), name="any.ply").model)
    except FormatError as error:
        fault = str(error)
    assert fault.startswith("any.ply")


@pytest.mark.parametrize(("order", "said"), [("<", b"binary_big_endian"), (">", b"binary_little_endian")])
def test_a_wrong_byte_order_is_named(order: str, said: bytes) -> None:
    written = file_of(floats(), order)
    line = written.split(b"\n")[1]
    with pytest.raises(FormatError, match="other byte order"):
        read_model(written.replace(line, b"format " + said + b" 1.0", 1))


def test_text_of_windows_and_with_empty_lines_is_read() -> None:
    head, end, body = file_of(floats(n=4), ascii=True).partition(b"end_header\n")
    rows = [row.split() for row in body.split(b"\n")]
    for row, word in zip(rows, (b"-nan(ind)", b"1.#INF", b"-1.#QNAN"), strict=False):
        row[7] = word
    loaded = read_model(head + end + b"\r\n\r\n".join(b"\t".join(row) for row in rows) + b"\r\n\r\n")
    assert (codes(loaded), len(loaded.model)) == ({"rows_dropped"}, 1)
    for word, told in ((b"1.#x", r"row 1.*'1\.#x'"), (b"0,25", "decimal points")):
        with pytest.raises(FormatError, match=told):
            read_model(head + end + body.replace(body.split(b"\n")[1].split()[0], word, 1))


def test_kernels_that_are_no_gaussians_are_named() -> None:
    columns = {name.replace("f_dc", "sh0"): column for name, column in floats().items()}
    with pytest.raises(UnsupportedFormatError, match="Beta"):
        read_model(file_of(columns | {"beta": columns["opacity"]}))
