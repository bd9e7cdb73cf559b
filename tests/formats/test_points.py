"""Point clouds in: every format says the same of the same points, and hostile files are refused."""

from __future__ import annotations

import io
import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from engine.errors import FormatError, InputError, UnsupportedFormatError
from engine.lab.points.cloud import PointCloud
from engine.lab.points.reading import read_point_cloud
from tests.formats.damage import little_memory
from tests.formats.point_files import COLORED, COLORS, INTENSITY, POINTS, TIMED, TIMES, las, pcd, ply

FILES = {
    "ply little endian": ply(),
    "ply big endian": ply(order=">"),
    "ply ascii": ply(order=""),
    "ply mesh": ply(faces=True),
    "ply ascii mesh": ply(order="", faces=True),
    "pcd ascii": pcd(encoding="ascii"),
    "pcd ascii integer colors": pcd(encoding="ascii", packed="U"),
    "pcd binary": pcd(),
    "pcd binary integer colors": pcd(packed="U"),
    "pcd compressed": pcd(encoding="binary_compressed"),
    "las 1.2": las(),
    "las 1.3": las(minor=3, format=3),
    "las 1.4": las(minor=4, format=7),
    "las with extra bytes": las(minor=4, format=7, extra=5),
}


def check(cloud: PointCloud) -> None:
    np.testing.assert_array_equal(cloud.points, POINTS)
    np.testing.assert_allclose(cloud.colors, COLORS / 255.0, atol=1e-7)
    np.testing.assert_array_equal(cloud.intensity, INTENSITY)
    np.testing.assert_allclose(cloud.times, TIMES, atol=1e-9)


@pytest.mark.parametrize("name", FILES)
def test_every_format_says_the_same(name: str, tmp_path: Path) -> None:
    path = tmp_path / "scan.bin"  # the name says nothing
    path.write_bytes(FILES[name])
    cloud, repairs = read_point_cloud(path)
    check(cloud)
    assert not repairs


@pytest.mark.parametrize("format", range(11))
def test_las_point_formats(format: int) -> None:
    cloud, _ = read_point_cloud(las(format=format, minor=4))
    np.testing.assert_array_equal(cloud.points, POINTS)
    assert (cloud.times is not None) == (format in TIMED)
    assert (cloud.colors is not None) == (format in COLORED)
    if cloud.colors is not None:
        np.testing.assert_allclose(cloud.colors, COLORS / 255.0, atol=1e-7)
    if cloud.times is not None:
        np.testing.assert_array_equal(cloud.times, TIMES)


@pytest.mark.parametrize("format", [3, 7])
def test_las_leaves_out_what_the_file_calls_noise(format: int) -> None:
    cloud, (repair,) = read_point_cloud(las(format=format, minor=4, classes=(2, 7, 2, 128 + 2)))
    np.testing.assert_array_equal(cloud.points, POINTS[[0, 2]])
    assert (repair.code, repair.count) == ("noise_dropped", 2)
    with pytest.raises(FormatError, match="all 4 points are noise"):
        read_point_cloud(las(format=format, minor=4, classes=(7, 7, 7, 7)))


def test_las_colors_of_eight_bits() -> None:
    cloud, (repair,) = read_point_cloud(las(bits=8))
    check(cloud)
    assert repair.code == "colors_scaled"


def test_las_black_everywhere_means_no_colors() -> None:
    assert read_point_cloud(las(colors=np.zeros_like(COLORS)))[0].colors is None


def test_las_may_go_on_where_it_says_so() -> None:
    check(read_point_cloud(las(minor=3, tail=b"waveform", waveforms=600))[0])
    with pytest.raises(FormatError, match="8 bytes follow the 4 points"):
        read_point_cloud(las(minor=3, tail=b"waveform"))


def test_colors_of_other_types() -> None:
    head = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"

    def read(kind: str, rows: str) -> tuple[PointCloud, list[str]]:
        names = "".join(f"property {kind} {name}\n" for name in ("red", "green", "blue"))
        cloud, repairs = read_point_cloud(f"{head}{names}end_header\n{rows}".encode())
        return cloud, [repair.code for repair in repairs]

    unit, none = read("float", "0 0 0 0.2 0.4 1\n1 1 1 0 0 nan\n")
    np.testing.assert_allclose(unit.colors, [[0.2, 0.4, 1.0], [0.0, 0.0, 0.0]], atol=1e-7)
    assert none == []
    wide, scaled = read("float", "0 0 0 51 102 255\n1 1 1 0 0 0\n")
    np.testing.assert_allclose(wide.colors, [[0.2, 0.4, 1.0], [0.0, 0.0, 0.0]], atol=1e-7)
    assert scaled == ["colors_scaled"]
    deep, _ = read("ushort", "0 0 0 13107 26214 65535\n1 1 1 0 0 0\n")
    np.testing.assert_allclose(deep.colors, [[0.2, 0.4, 1.0], [0.0, 0.0, 0.0]], atol=1e-7)


def test_points_without_a_place_are_left_out() -> None:
    points = POINTS.copy()
    points[1, 2], points[3, 0] = np.nan, np.inf
    for data in (ply(points), pcd(points), pcd(points, encoding="ascii")):
        cloud, (repair,) = read_point_cloud(data)
        np.testing.assert_array_equal(cloud.points, POINTS[[0, 2]])
        np.testing.assert_allclose(cloud.colors, COLORS[[0, 2]] / 255.0, atol=1e-7)
        np.testing.assert_allclose(cloud.times, TIMES[[0, 2]])
        assert (repair.code, repair.count) == ("rows_dropped", 2)
        assert "row 1" in repair.text
    with pytest.raises(FormatError, match="no point has a place"):
        read_point_cloud(ply(np.full((4, 3), np.nan)))


@pytest.mark.parametrize("name", ["ply little endian", "pcd binary", "pcd compressed", "las 1.2", "las 1.4"])
def test_a_file_cut_anywhere_is_refused(name: str) -> None:
    data = FILES[name]
    for end in range(len(data)):
        with pytest.raises(FormatError):
            read_point_cloud(data[:end])


@pytest.mark.parametrize("name", ["ply ascii", "pcd ascii"])
def test_a_text_file_cut_before_its_last_row_is_refused(name: str) -> None:
    data = FILES[name]
    for end in range(data.rindex(b"\n", 0, len(data) - 1)):
        with pytest.raises(FormatError):
            read_point_cloud(data[:end])


@pytest.mark.parametrize("name", FILES)
def test_a_changed_byte_never_does_worse_than_be_refused(name: str) -> None:
    data = FILES[name]
    rng = np.random.default_rng(0)
    read = 0
    for at in range(len(data)):
        for value in (data[at] ^ (1 << rng.integers(8)), int(rng.integers(256))):
            mutant = bytearray(data)
            mutant[at] = value
            try:
                cloud, _ = read_point_cloud(bytes(mutant))
            except FormatError:
                continue
            read += 1
            assert 1 <= len(cloud) <= 4
            assert np.isfinite(cloud.points).all()
    assert read  # many a byte is only a coordinate


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "is empty"),
        (b"VERSION 0.7\n", "no line 'DATA'"),
        (b"hello", "none of the point clouds"),
        (ply().replace(b"vertex 4", b"vertex 999999999999"), "announces 999999999999 rows"),
        (ply(order="").replace(b"vertex 4", b"vertex 999999999999"), "announces 999999999999 rows"),
        (ply().replace(b"double x", b"double q"), "property 'x'"),
        (ply().replace(b"uchar green", b"char green"), "different types"),
        (pcd().replace(b"POINTS 4", b"POINTS 5"), "not WIDTH x HEIGHT"),
        (pcd().replace(b"WIDTH 4", b"WIDTH 999999999").replace(b"POINTS 4", b"POINTS 999999999"), "999999999"),
        (pcd().replace(b"COUNT 1 1 1 4", b"COUNT 1 1 1 9999"), "COUNT 9999"),
        (pcd().replace(b"VERSION 0.7", b"VERSION 0.6"), "version '0.6'"),
        (pcd().replace(b"DATA binary", b"DATA base64"), "unknown encoding"),
        (pcd().replace(b"SIZE 4 4", b"SIZE 3 4"), "SIZE '3'"),
        (pcd().replace(b"FIELDS x y", b"FIELDS x x"), "announced twice"),
        (pcd().replace(b"WIDTH 4\n", b"WIDTH 4\nWIDTH 4\n"), "two lines 'WIDTH'"),
        (pcd().replace(b"VERSION", b"#" + b"x" * 70000 + b"\nVERSION"), "longer than 65536"),
        (pcd() + b"x", "1 bytes follow"),
        (las()[:104] + bytes([3 | 128]) + las()[105:], "points cannot be unpacked"),
        (las()[:104] + bytes([11]) + las()[105:], "LAS header cannot be read: 11"),
        (las()[:25] + bytes([9]) + las()[26:], "LAS header cannot be read"),
        (las()[:107] + struct.pack("<I", 2**32 - 1) + las()[111:], "announces 4294967295 points"),
        (las()[:105] + struct.pack("<H", 33) + las()[107:], "Incoherent point size"),
        (las()[:131] + struct.pack("<d", np.nan) + las()[139:], "scale"),
        (las()[:96] + struct.pack("<I", 100) + las()[100:], "inside the header"),
    ],
)
def test_refused_with_a_reason(data: bytes, message: str) -> None:
    with pytest.raises(FormatError, match=message) as caught:
        read_point_cloud(data, name="scan.x")
    assert str(caught.value).startswith("scan.x")


def test_a_gaussian_model_is_no_point_cloud() -> None:
    with pytest.raises(UnsupportedFormatError, match="is a Gaussian model"):
        read_point_cloud(Path(__file__).parents[1] / "data" / "train_1000.ply")


def test_what_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no regular file"):
        read_point_cloud(tmp_path)
    with pytest.raises(InputError, match="cannot be read"):
        read_point_cloud(tmp_path / "none.ply")


HEAD = pcd(encoding="binary_compressed").split(b"DATA binary_compressed\n")[0] + b"DATA binary_compressed\n"
UNPACKED = 4 * 32


@pytest.mark.parametrize(
    ("stream", "message"),
    [
        (b"\x05ab", "is broken"),
        (b"\xe0" + bytes(1), "is broken"),
        (b"\x00a\x20\x05", "is broken"),
        (b"\x00a\xe0\xff\x00", "holds more bytes"),
        (b"\x00a\x20\x00", "holds 4 bytes, expected 128"),
        (b"\x00", "128 bytes compressed to 1"),
    ],
)
def test_broken_lzf(stream: bytes, message: str) -> None:
    with pytest.raises(FormatError, match=message):
        read_point_cloud(HEAD + struct.pack("<II", len(stream), UNPACKED) + stream)


def laz(count: int = 4) -> bytes:
    laspy = pytest.importorskip("laspy")
    with laspy.open(io.BytesIO(las(minor=4, format=7))) as reader:
        stored = reader.read()
    stored.points = stored.points[np.arange(count) % 4]
    packed = io.BytesIO()
    stored.write(packed, do_compress=True)
    return packed.getvalue()


def test_laz_says_the_same() -> None:
    cloud, _ = read_point_cloud(laz())
    check(cloud)


def test_laz_that_claims_too_much_is_refused_before_it_is_unpacked() -> None:
    data = bytearray(laz())
    data[247:255] = struct.pack("<Q", 2**40)
    with little_memory(5e6), pytest.raises(FormatError, match="announces 1099511627776 points"):
        read_point_cloud(bytes(data))


def test_laz_whose_table_claims_memory_that_is_not_there_is_refused() -> None:
    data = bytearray(laz())
    (start,) = struct.unpack_from("<I", data, 96)
    (table,) = struct.unpack_from("<q", data, start)
    data[table + 4 : table + 8] = struct.pack("<I", 2**32 - 1)  # chunks: 64 GiB of entries
    with pytest.raises(FormatError, match="cannot be unpacked"):
        read_point_cloud(bytes(data))


@pytest.mark.parametrize(("module", "data"), [("laspy", las()), ("lazrs", laz()), ("lzf", FILES["pcd compressed"])])
def test_a_missing_package_is_named(module: str, data: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=r"pip install 'mark3dgs\[capture\]'"):
        read_point_cloud(data)


def test_a_cloud_checks_its_shapes() -> None:
    with pytest.raises(InputError, match=r"colors has shape \(2, 3\), expected \(4, 3\)"):
        PointCloud(POINTS, COLORS[:2])
