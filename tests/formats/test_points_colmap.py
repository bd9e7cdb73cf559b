"""Points out of COLMAP models: both forms say the same, and hostile ones are refused."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.errors import FormatError, InputError
from engine.lab.points.reconstruction import ColmapPoints, read_points, read_reconstruction
from tests.formats.test_cameras_colmap import colmap_binary, colmap_text

ROWS = [(7, 0.5, -1.25, 3e-3, 1, 2, 255, 0.75, [(1, 2), (3, 4)]), (2**40, 1e6, 2.0, -3.0, 0, 128, 9, -1.0, [])]


def text(rows=ROWS) -> bytes:
    lines = ["# 3D point list"]
    for *values, track in rows:
        lines.append(" ".join(repr(v) for v in [*values, *(n for pair in track for n in pair)]))
    return ("\n".join(lines) + "\n").encode()


def binary(rows=ROWS) -> bytes:
    content = struct.pack("<Q", len(rows))
    for *values, track in rows:
        content += struct.pack("<Q3d3BdQ", *values, len(track))
        content += b"".join(struct.pack("<ii", *pair) for pair in track)
    return content


def check(points: ColmapPoints) -> None:
    np.testing.assert_array_equal(points.positions, [row[1:4] for row in ROWS])
    np.testing.assert_array_equal(points.colors, [row[4:7] for row in ROWS])
    assert points.colors.dtype == np.uint8


def test_text_and_binary_say_the_same() -> None:
    check(read_points(text(), "points3D.txt", binary=False))
    check(read_points(binary(), "points3D.bin", binary=True))


def test_none_at_all() -> None:
    assert len(read_points(b"# none\n", "f", binary=False)) == 0
    assert len(read_points(struct.pack("<Q", 0), "f", binary=True)) == 0


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"abc", "3 bytes, too few"),
        (struct.pack("<Q", 2**62) + bytes(100), f"claims {2**62} points in 108 bytes"),
        (binary()[:-1], "row 1"),
        (binary() + b"x", "1 bytes after its last point"),
        (binary([(1, 0.0, 0.0, 0.0, 1, 1, 1, 0.0, [])])[:-8] + struct.pack("<Q", 2**60), "beyond the end"),
        (binary([(1, float("nan"), 0.0, 0.0, 1, 1, 1, 0.0, [])]), "row 0: the position .*not finite"),
        (binary([(1, 0.0, 0.0, 0.0, 1, 1, 1, float("inf"), [])]), "row 0: the error inf"),
    ],
)
def test_hostile_binary(data: bytes, message: str) -> None:
    with pytest.raises(FormatError, match=f"evil.bin.*{message}"):
        read_points(data, "evil.bin", binary=True)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (b"1 0 0 0 1 1 1", "7 words"),
        (b"1 0 0 0 1 1 1 0.5 3", "9 words"),
        (b"1 0 0 x 1 1 1 0.5", "is no point"),
        (b"1 0 0 0 1 300 1 0.5", "300"),
        (b"1 0 inf 0 1 3 1 0.5", "not finite"),
        (b"\xff\xfe 0 0 \xff 1 3 1 0.5", "is no point"),
    ],
)
def test_hostile_text(line: bytes, message: str) -> None:
    with pytest.raises(FormatError, match=f"evil.txt, row 2: .*{message}"):
        read_points(text() + line, "evil.txt", binary=False)


@settings(max_examples=150)
@given(st.integers(0, len(binary()) - 1), st.binary(max_size=12), st.booleans())
def test_mutations_are_read_or_refused(at: int, patch: bytes, whole: bool) -> None:
    data = binary()[:at] + patch + (binary()[at + len(patch) :] if whole else b"")
    for form in (True, False):
        try:
            points = read_points(data, "f", binary=form)
        except FormatError:
            continue
        assert np.isfinite(points.positions).all()


@pytest.mark.parametrize(("name", "content"), [("points3D.txt", text()), ("points3D.bin", binary())])
def test_whole_reconstruction(tmp_path: Path, name: str, content: bytes) -> None:
    inside = tmp_path / "sparse" / "0"
    if name.endswith("bin"):
        colmap_binary(inside)
    else:
        colmap_text(inside, "OPENCV", "300 310.5 90.25 50 0.1 0.2 0.3 0.4")
    with pytest.raises(InputError, match="holds no COLMAP model"):
        read_reconstruction(tmp_path)
    (inside / name).write_bytes(content)
    found = read_reconstruction(tmp_path)
    check(found.points)
    assert [photo.name for photo in found.photos] == ["image 0.jpg", "image 1.jpg", "image 2.jpg"]
    assert found.photos[0].camera.K[0, 0] == 300
    assert found.photos[0].distortion == ((0.0,) * 4 if name.endswith("bin") else (0.1, 0.2, 0.3, 0.4))


@pytest.mark.parametrize(
    ("model", "parameters", "distortion"),
    [
        ("PINHOLE", "300 310 90 50", (0, 0, 0, 0)),
        ("SIMPLE_RADIAL", "300 90 50 0.1", (0.1, 0, 0, 0)),
        ("RADIAL", "300 90 50 0.1 0.2", (0.1, 0.2, 0, 0)),
    ],
)
def test_distortion(tmp_path: Path, model: str, parameters: str, distortion: tuple[float, ...]) -> None:
    folder = colmap_text(tmp_path / "m", model, parameters)
    (folder / "points3D.txt").write_bytes(text())
    assert {photo.distortion for photo in read_reconstruction(folder).photos} == {distortion}
