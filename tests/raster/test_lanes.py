"""Every operation on sixteen lanes against NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.deferred import text_of
from engine.kernels.jit import kernel
from engine.raster import lane_order
from engine.raster.lane_math import cross, exp2, log2, row_times, times
from engine.raster.lane_memory import (
    aligned,
    append_set_bits,
    count_bits,
    entry,
    fetch_add,
    load,
    load_quarters,
    load_some,
    lowest_bit,
    number,
    put,
    store,
    store_quarters,
    store_some,
    sum_rows,
    transpose,
)
from engine.raster.lane_order import unzip3, unzip4, zip3, zip4
from engine.raster.lanes import (
    bits_of,
    fma,
    ir_function,
    magnitude,
    maximum,
    minimum,
    minus_magnitude,
    root,
    round_down,
    select,
    spread,
)
from tests.raster.scenes import TOLERANCE

_THREE, _SIXTEEN = (0,) * 3, (0,) * 16


def numbers(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, 3.0, count).astype(np.float32)


@kernel
def _arithmetic(x, y, out):
    a, b, s = load(x, 0), load(y, 0), np.float32(1.5)
    store(out, 0, a + b)
    store(out, 16, a - s)
    store(out, 32, s * b)
    store(out, 48, a / b)
    store(out, 64, -a)
    store(out, 80, fma(a, s, b))
    store(out, 96, minimum(a, b))
    store(out, 112, maximum(a, s))
    store(out, 128, select((a > b) & (a >= s), a, b))
    store(out, 144, select((a < b) | (a <= s), a, b))
    store(out, 160, minus_magnitude(a))
    store(out, 176, root(a * a))
    store(out, 192, round_down(a))
    store(out, 208, spread(s))
    a += b
    a *= s
    a -= s
    store(out, 224, a)


def test_arithmetic() -> None:
    x, y, out = numbers(16), numbers(16, 1), np.zeros(240, np.float32)
    _arithmetic(x, y, out)
    expected = [
        x + y,
        x - 1.5,
        1.5 * y,
        x / y,
        -x,
        1.5 * x + y,
        np.minimum(x, y),
        np.maximum(x, 1.5),
        np.where((x > y) & (x >= 1.5), x, y),
        np.where((x < y) | (x <= 1.5), x, y),
        -np.abs(x),
        np.abs(x),
        np.floor(x),
        np.full(16, 1.5),
        (x + y) * 1.5 - 1.5,
    ]
    np.testing.assert_allclose(out.reshape(15, 16), np.stack(expected), rtol=1e-6, atol=1e-6)


def test_comparisons_with_nan_are_false() -> None:
    @kernel
    def compare(x, y):
        return bits_of(load(x, 0) > load(y, 0)), bits_of(load(x, 0) <= load(y, 0))

    x, y = numbers(16), numbers(16, 1)
    x[[0, 7]] = np.nan
    above, below = compare(x, y)
    weights = 1 << np.arange(16)
    assert above == int(weights[x > y].sum())
    assert below == int(weights[x <= y].sum())
    assert (above | below) & 0b10000001 == 0


@kernel
def _powers(x, out):
    for i in range(0, x.shape[0], 16):
        store(out, i, exp2(load(x, i)))


@kernel
def _logarithms(x, out):
    for i in range(0, x.shape[0], 16):
        store(out, i, log2(load(x, i)))


def test_exp2() -> None:
    x = np.linspace(-126.0, 126.0, 16 * 1000).astype(np.float32)
    out = np.empty_like(x)
    _powers(x, out)
    assert np.abs(out / 2.0 ** x.astype(np.float64) - 1.0).max() <= TOLERANCE["exp2"]


def test_log2() -> None:
    x = (2.0 ** np.linspace(-120.0, 120.0, 16 * 1000)).astype(np.float32)
    out = np.empty_like(x)
    _logarithms(x, out)
    error = np.abs(out - np.log2(x.astype(np.float64)))
    near_one = np.abs(np.log2(x)) < 4
    assert error[near_one].max() <= TOLERANCE["log2"]
    assert (error / np.maximum(np.abs(np.log2(x.astype(np.float64))), 4.0)).max() <= TOLERANCE["log2"]


@kernel
def _zips(x, out):
    a, b, c = unzip3(load(x, 0), load(x, 16), load(x, 32))
    store(out, 0, a)
    store(out, 16, b)
    store(out, 32, c)
    a, b, c = zip3(a, b, c)
    store(out, 48, a)
    store(out, 64, b)
    store(out, 80, c)
    a, b, c, d = unzip4(load(x, 0), load(x, 16), load(x, 32), load(x, 48))
    store(out, 96, a)
    store(out, 112, b)
    store(out, 128, c)
    store(out, 144, d)
    a, b, c, d = zip4(a, b, c, d)
    store(out, 160, a)
    store(out, 176, b)
    store(out, 192, c)
    store(out, 208, d)


def test_zip_and_unzip() -> None:
    x, out = numbers(64), np.zeros(224, np.float32)
    _zips(x, out)
    np.testing.assert_array_equal(out[:48], x[:48].reshape(16, 3).T.ravel())
    np.testing.assert_array_equal(out[48:96], x[:48])
    np.testing.assert_array_equal(out[96:160], x.reshape(16, 4).T.ravel())
    np.testing.assert_array_equal(out[160:], x)


@pytest.mark.parametrize("register", [4, 8, 16])
def test_zip_and_unzip_on_registers_of_any_width(monkeypatch: pytest.MonkeyPatch, register: int) -> None:
    """What Arm and AVX2 would be given; the numbers are the same on every processor."""
    monkeypatch.setattr(lane_order, "REGISTER", register)
    x, out = numbers(64), np.zeros(224, np.float32)
    for piece in (zip3, unzip3):  # made anew, of registers of this width
        monkeypatch.setattr(piece, "_compiled", None)
    kernel(_zips.function)(x, out)
    np.testing.assert_array_equal(out[:48], x[:48].reshape(16, 3).T.ravel())
    np.testing.assert_array_equal(out[48:96], x[:48])


def test_blocks_are_read_and_written_row_by_row() -> None:
    @kernel
    def through(x, out):
        store(out, 0, load_quarters(x, 4))
        store_quarters(out, 16 + 4, magnitude(load_quarters(x, 4)))

    x, out = numbers(80), np.zeros(16 + 80, np.float32)
    through(x, out)
    row = np.concatenate([x[16 * block + 4 : 16 * block + 8] for block in range(4)])
    np.testing.assert_array_equal(out[:16], row)
    np.testing.assert_array_equal(out[16 : 16 + 64].reshape(4, 16)[:, 4:8].ravel(), np.abs(row))
    assert not np.delete(out[16 : 16 + 64].reshape(4, 16), np.s_[4:8], axis=1).any()


@kernel
def _rows(x, out):
    store(out, 0, sum_rows(x, 0, _THREE))
    store(out, 16, sum_rows(x, 0, _SIXTEEN))
    transpose(x, 0, 256)


def test_reductions_and_transpose() -> None:
    x, out = np.concatenate([numbers(256), np.zeros(256, np.float32)]), np.zeros(32, np.float32)
    _rows(x, out)
    rows = x[:256].reshape(16, 16)
    np.testing.assert_allclose(out[:16], [*rows[:3].sum(1), *[0.0] * 13], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(out[16:32], rows.sum(1), rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(x[256:].reshape(16, 16), rows.T)


@kernel
def _partial(x, count, out):
    store(out, 0, load_some(x, 2, count))
    store_some(out, 18, count, load(x, 0))


@pytest.mark.parametrize("count", [-3, 0, 1, 11, 16, 40])
def test_partial_loads_and_stores(count: int) -> None:
    x, out = numbers(20), np.full(40, 7.0, np.float32)
    _partial(x, np.int32(count), out)
    kept = min(max(count, 0), 16)
    np.testing.assert_array_equal(out[:16], [*x[2 : 2 + kept], *[0.0] * (16 - kept)])
    np.testing.assert_array_equal(out[16:], [7.0, 7.0, *x[:kept], *[7.0] * (22 - kept)])


@kernel
def _append(bits, items):
    append_set_bits(items, 1, bits, np.int32(32))
    return count_bits(bits), lowest_bit(bits)


@pytest.mark.parametrize("seed", range(3))
def test_set_bits_are_listed_in_order_and_nothing_is_written_far_behind_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for bits in [0xFFFF, 0x8001, 0x0100, 0x00FF, 0xFF00, *rng.integers(1, 1 << 16, 200)]:
        items = np.full(20, -1, np.int32)
        places = [bit for bit in range(16) if int(bits) >> bit & 1]
        assert _append(np.int32(bits), items) == (len(places), places[0])
        np.testing.assert_array_equal(items[1 : 1 + len(places)], [32 + place for place in places])
        assert items[0] == -1
        assert (items[17:] == -1).all()


def test_no_set_bit_lists_nothing_that_counts() -> None:
    items = np.full(20, -1, np.int32)
    assert _append(np.int32(0), items)[0] == 0
    assert (items[17:] == -1).all()


def test_single_numbers_and_the_queue() -> None:
    @kernel
    def move(x, whole, queue):
        put(x, 2, number(x, 1) + np.float32(1.0))
        fetch_add(queue, 0, 5)
        return entry(whole, 3)

    x, whole, queue = numbers(4), np.arange(10, 20, dtype=np.int32), np.zeros(1, np.int64)
    before = x.copy()
    assert move(x, whole, queue) == 13
    np.testing.assert_array_equal(x, [before[0], before[1], before[1] + np.float32(1.0), before[3]])
    assert queue[0] == 5


@kernel
def _algebra(x, out):
    m = (
        load(x, 0),
        load(x, 16),
        load(x, 32),
        load(x, 48),
        load(x, 64),
        load(x, 80),
        load(x, 96),
        load(x, 112),
        load(x, 128),
    )
    v, w = (load(x, 144), load(x, 160), load(x, 176)), (load(x, 192), load(x, 208), load(x, 224))
    results = (times(m, v), row_times(v, m), cross(v, w))
    for k in range(3):
        for j in range(3):
            store(out, (3 * k + j) * 16, results[k][j])


def test_vector_algebra() -> None:
    x, out = numbers(240), np.zeros(144, np.float32)
    _algebra(x, out)
    rows = x.reshape(15, 16)
    m, v, w = rows[:9].reshape(3, 3, 16), rows[9:12], rows[12:15]
    expected = [np.einsum("ijl,jl->il", m, v), np.einsum("il,ijl->jl", v, m), np.cross(v, w, axis=0)]
    np.testing.assert_allclose(out.reshape(3, 3, 16), np.stack(expected), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("shape", [(0,), (3,), (5, 7), (1 << 19,)])
def test_aligned_arrays(shape: tuple[int, ...]) -> None:
    array = aligned(shape)
    assert array.shape == shape
    assert array.dtype == np.float32
    assert array.size == 0 or array.ctypes.data % 64 == 0
    array[:] = 1.0


def test_an_intrinsic_of_other_types_is_another_text() -> None:
    def emit(b, x):
        return x

    texts = {text_of(ir_function(*kinds)(emit)) for kinds in (("int32", "int32"), ("int64", "int64"))}
    assert len(texts) == 2
