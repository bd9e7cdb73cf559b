"""SuperSplat's compressed PLY: its steps, its bounds, its faults."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from engine.errors import FormatError
from engine.formats import encode_model, read_model
from engine.formats.morton import morton_order
from engine.model import SH_C0, GaussianModel
from tests.formats.models import random_model

COLOR_BOUNDS = [f" {end}_{channel}".encode() for end in ("min", "max") for channel in "rgb"]


def rotation_errors(a: GaussianModel, b: GaussianModel) -> npt.NDArray[np.float64]:
    """Degrees between the rotations."""
    dots = np.abs(np.einsum("nq,nq->n", a.quats.astype(np.float64), b.quats))
    return np.degrees(2 * np.arccos(np.minimum(dots, 1)))


def chunk_extents(values: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """(N, 3) extent of every row's chunk, by a plain loop."""
    extents = np.empty_like(values)
    for start in range(0, len(values), 256):
        extents[start : start + 256] = np.ptp(values[start : start + 256], axis=0)
    return extents


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("n", [1, 256, 257, 40000])
def test_round_trip_within_half_a_step(degree: int, n: int) -> None:
    model = random_model(degree, n)
    data = encode_model(model, "compressed.ply")
    loaded = read_model(data)
    assert loaded.format == "compressed.ply"
    assert loaded.repairs == ()
    back, model = loaded.model, model.take(morton_order(model.means))
    steps = np.array([2047, 1023, 2047])
    for name in ("means", "log_scales"):
        values = getattr(model, name)
        error = np.abs(getattr(back, name) - values)
        assert (error <= 0.5 * chunk_extents(values) / steps * 1.001 + 1e-6).all(), name
    colors, colors_back = 0.5 + SH_C0 * model.sh[:, 0], 0.5 + SH_C0 * back.sh[:, 0]
    assert (np.abs(colors - colors_back) <= 0.5 * chunk_extents(colors) / 255 * 1.001 + 1e-6).all()
    assert np.abs(model.opacities - back.opacities).max() <= 0.5 / 255 + 1e-6
    assert rotation_errors(model, back).max() < 0.3
    if degree:
        assert np.abs(model.sh[:, 1:] - back.sh[:, 1:]).max() <= 1 / 32 / 2 + 1e-6


def test_coefficients_at_the_ends_mean_four() -> None:
    model = random_model(1, 300)
    sh = model.sh.copy()
    sh[:, 1], sh[:, 2] = 9, -9
    back = read_model(encode_model(model.with_(sh=sh), "compressed.ply")).model
    assert (back.sh[:, 1] == 4).all()
    assert (back.sh[:, 2] == -4).all()


def without_color_bounds(data: bytes, chunks: int) -> bytes:
    """What early versions of SuperSplat wrote: colors between 0 and 1."""
    head, body = data.split(b"end_header\n", 1)
    lines = [line for line in head.split(b"\n") if line[-6:] not in COLOR_BOUNDS]
    bounds = np.frombuffer(body, "<f4", chunks * 18).reshape(chunks, 18)[:, :12]
    return b"\n".join(lines) + b"end_header\n" + bounds.tobytes() + body[chunks * 72 :]


def test_chunks_without_color_bounds() -> None:
    model = random_model(0, 300)
    sh = np.zeros((300, 1, 3), dtype=np.float32)
    sh[::2], sh[1::2] = -0.5 / SH_C0, 0.5 / SH_C0  # colors 0 and 1 in every chunk: the bounds are 0 and 1
    data = encode_model(model.with_(sh=sh), "compressed.ply")
    old = without_color_bounds(data, 2)
    assert len(old) < len(data)
    np.testing.assert_allclose(read_model(old).model.sh, read_model(data).model.sh, atol=1e-6)


def test_degree_four_is_read_to_degree_three() -> None:
    data = encode_model(random_model(3, 300), "compressed.ply")
    head, body = data.split(b"element sh 300\n", 1)[0], data[: -300 * 45].split(b"end_header\n", 1)[1]
    names = "".join(f"property uchar f_rest_{i}\n" for i in range(72)).encode()
    rest = np.frombuffer(data[-300 * 45 :], np.uint8).reshape(300, 3, 15)
    longer = np.concatenate([rest, np.full((300, 3, 9), 77, np.uint8)], axis=2)
    four = head + b"element sh 300\n" + names + b"end_header\n" + body + longer.tobytes()
    loaded = read_model(four)
    assert [repair.code for repair in loaded.repairs] == ["degree_dropped"]
    np.testing.assert_array_equal(loaded.model.sh, read_model(data).model.sh)


def test_big_endian_and_foreign_elements() -> None:
    data = encode_model(random_model(1, 300), "compressed.ply")
    head, body = data.split(b"end_header\n", 1)
    words = np.frombuffer(body, "<u4", (2 * 72 + 300 * 16) // 4)
    extra = b"element frame 1\nproperty int number\nend_header\n"
    swapped = words.astype(">u4").tobytes() + body[words.nbytes :] + bytes(4)
    big = head.replace(b"little", b"big") + extra + swapped
    loaded = read_model(big)
    np.testing.assert_array_equal(loaded.model.means, read_model(data).model.means)
    np.testing.assert_array_equal(loaded.model.sh, read_model(data).model.sh)
    assert [repair.code for repair in loaded.repairs] == ["extra_elements"]


@pytest.mark.parametrize(
    ("old", "new", "element", "prop"),
    [
        (b"element chunk 2", b"element chunk 3", "chunk", None),
        (b"element vertex 300", b"element vertex 600", "chunk", None),
        (b"element sh 300", b"element sh 299", "sh", None),
        (b"property uchar f_rest_8\n", b"", "sh", None),
        (b"uchar f_rest_8", b"uchar f_rest_9", "sh", "f_rest_8"),
        (b"uchar f_rest_8", b"char f_rest_8", "sh", "f_rest_8"),
        (b"uint packed_scale", b"int packed_scale", "vertex", "packed_scale"),
        (b"uint packed_scale", b"uint packed", "vertex", "packed_scale"),
        (b"float min_y", b"double min_y", "chunk", "min_y"),
        (b"float max_b", b"float max_a", "chunk", "max_b"),
        (b"element chunk", b"element block", "chunk", None),
    ],
)
def test_every_fault_is_named(old: bytes, new: bytes, element: str, prop: str | None) -> None:
    data = encode_model(random_model(1, 300), "compressed.ply")
    assert old in data
    with pytest.raises(FormatError) as caught:
        read_model(data.replace(old, new, 1), name="scene")
    assert (caught.value.file, caught.value.element, caught.value.prop) == ("scene", element, prop)


def test_cut_off_or_too_long() -> None:
    data = encode_model(random_model(1, 300), "compressed.ply")
    with pytest.raises(FormatError, match="element 'sh', row 299"):
        read_model(data[:-1])
    with pytest.raises(FormatError, match="1 bytes follow"):
        read_model(data + b"\0")


def test_a_chunk_with_bounds_that_are_no_numbers_is_left_out() -> None:
    data = encode_model(random_model(0, 300), "compressed.ply")
    head, body = data.split(b"end_header\n", 1)
    hostile = np.array([np.nan, -np.inf, 3e38], dtype="<f4").tobytes()
    loaded = read_model(head + b"end_header\n" + hostile + body[12:])
    assert len(loaded.model) == 300 - 256
    assert [(repair.code, repair.count) for repair in loaded.repairs] == [("rows_dropped", 256)]


def test_morton_order_is_a_permutation_that_keeps_neighbours_together() -> None:
    means = random_model(0, 20000).means
    order = morton_order(means)
    np.testing.assert_array_equal(np.sort(order), np.arange(20000))
    grid = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    codes = sum(((grid[:, axis] >> bit) & 1) << (3 * bit + axis) for axis in range(3) for bit in range(2))
    np.testing.assert_array_equal(morton_order(grid.astype(np.float32)), np.argsort(codes))
    assert chunk_extents(means[order]).mean() < 0.4 * chunk_extents(means).mean()
    np.testing.assert_array_equal(morton_order(np.ones((5, 3), np.float32)), np.arange(5))
