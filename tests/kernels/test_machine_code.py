"""Kernels kept as machine code: called as numba would call them, found again by their text, never out of date."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from engine.kernels import kernel_cache
from engine.kernels import machine_code as native
from engine.kernels.deferred import text_of
from engine.kernels.jit import inlined, kernel, parallel_kernel, share_of

SCALE = 2.0


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    place = tmp_path / "kernels"
    place.mkdir()
    monkeypatch.setattr(kernel_cache, "folders", lambda: (place,))
    monkeypatch.setattr(kernel_cache, "folder", lambda: place)
    return place


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A word for each kernel that is compiled."""
    words: list[str] = []
    monkeypatch.setattr(native, "on_compiling", [lambda: words.append("compiled")])
    return words


def _mixed(x, some, flag, n, f, out, more):  # type: ignore[no-untyped-def]
    pair, (weight, shift) = some
    if more is not None:
        shift += more[0]
    for i in range(len(x)):
        out[i] = (x[i] * weight + pair[i % 2] if flag else -1.0) + shift + n * f
    return out[0], len(x), flag


@pytest.mark.usefixtures("store")
def test_arguments_of_every_kind_arrive() -> None:
    run = kernel(_mixed)
    grid = np.arange(24.0).reshape(4, 6)
    frozen = np.arange(4.0)
    frozen.flags.writeable = False
    pair = np.array([10, 20], np.int32)
    for x in (np.arange(4.0), frozen, grid[:, 2], np.asfortranarray(grid)[1], np.arange(4, dtype=np.float32)):
        cases = (
            (True, 3, 0.5, None),
            (np.bool_(False), np.int64(-2), np.float32(0.25), ()),
            (True, np.uint8(7), 1, (3,)),
        )
        for flag, n, f, more in cases:
            more = more or None
            out, wanted = np.zeros(len(x)), np.zeros(len(x))
            some = (pair, (2.0, np.float64(1.0)))
            first, length, said = run(x, some, flag, n, f, out, more)
            assert (first, length, bool(said)) == _mixed(x, some, flag, n, f, wanted, more)
            np.testing.assert_array_equal(out, wanted)
    assert run.signatures
    assert run._compiled is None, "numba ran it"


@pytest.mark.usefixtures("store")
def test_arrays_of_every_layout_are_read_as_they_lie() -> None:
    @kernel
    def weigh(x):
        s = 0.0
        for i in range(x.shape[0]):
            for j in range(x.shape[1]):
                s += x[i, j] * (1 + i + 10 * j)
        return s

    grid = np.arange(24.0).reshape(4, 6)
    packed = np.zeros(24, np.dtype([("byte", "u1"), ("x", "f8")]))["x"].reshape(4, 6)  # on odd addresses
    packed[:] = grid
    for x in (grid, np.asfortranarray(grid), grid[::2, 1:], grid.T, grid[:0], packed):
        i, j = np.indices(x.shape)
        assert weigh(x) == (x * (1 + i + 10 * j)).sum()
    assert len({native.kind_of(x) for x in (grid, grid.T, grid[::2, 1:], packed)}) == 4


def test_the_processor_is_the_one_that_numba_was_told(monkeypatch: pytest.MonkeyPatch) -> None:
    find = native.processor.__wrapped__
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    monkeypatch.setenv("NUMBA_CPU_FEATURES", "+sse2")
    assert find() == ("generic", "+sse2")
    monkeypatch.delenv("NUMBA_CPU_NAME")
    monkeypatch.delenv("NUMBA_CPU_FEATURES")
    assert "," in find()[1]


@pytest.mark.usefixtures("store")
def test_what_numba_alone_knows_is_left_to_it() -> None:
    @kernel
    def first(values):
        return values[0]

    table = np.array([(1, 2.5)], dtype=[("a", "i4"), ("b", "f8")])
    assert native.kind_of(table) is None
    assert first(table)["b"] == 2.5

    @kernel(allocates=True)
    def doubled(x):
        return 2 * x

    np.testing.assert_array_equal(doubled(np.arange(3)), [0, 2, 4])


def test_code_is_kept_and_found_and_a_broken_file_is_made_anew(store: Path, compiled: list[str]) -> None:
    def total(x):  # type: ignore[no-untyped-def]
        s = 0.0
        for each in x:
            s += math.exp(each)
        return s

    wanted = np.exp([0.5, 1.5]).sum()
    assert kernel(total)(np.array([0.5, 1.5])) == pytest.approx(wanted)
    assert kernel(total)(np.array([0.5, 1.5])) == pytest.approx(wanted)
    assert compiled == ["compiled"]
    (file,) = store.iterdir()
    whole = file.read_bytes()
    for broken in (whole[:-100], whole[:-1] + bytes([whole[-1] ^ 1]), b"", b"{}\n", b"\xff\xfe"):
        file.write_bytes(broken)
        compiled.clear()
        assert kernel(total)(np.array([0.5, 1.5])) == pytest.approx(wanted)
        assert compiled == ["compiled"]
        assert [path.name for path in store.iterdir()] == [file.name]


def test_code_that_calls_what_is_not_there_is_not_loaded() -> None:
    """LLVM would end the process."""
    assert native.load(native.Code("f", [], [], False, ["no_such_function_anywhere"], b"")) is None
    assert native.load(native.Code("f", ["<4 x float>"], [], False, [], b"")) is None


def _uses(piece, constant):  # type: ignore[no-untyped-def]
    def f(x):  # type: ignore[no-untyped-def]
        return piece(x) * constant

    return f


def test_another_text_is_another_kernel() -> None:
    once, twice = inlined(lambda x: x * SCALE), inlined(lambda x: x * SCALE + 1)
    assert text_of(_uses(once, 1.0)) == text_of(_uses(once, 1.0))
    others = [_uses(twice, 1.0), _uses(once, 2.0), _uses(once, np.float32(1.0)), _uses(once, 1)]
    assert len({text_of(f) for f in (_uses(once, 1.0), *others)}) == 5
    assert text_of(_uses(inlined(lambda x: x * SCALE, allocates=True), 1.0)) != text_of(_uses(once, 1.0))


def test_a_constant_of_the_module_is_part_of_the_text(monkeypatch: pytest.MonkeyPatch) -> None:
    before = text_of(_uses(inlined(lambda x: x * SCALE), 1.0))
    monkeypatch.setitem(globals(), "SCALE", 3.0)
    assert text_of(_uses(inlined(lambda x: x * SCALE), 1.0)) != before


def test_what_has_no_text_is_refused() -> None:
    with pytest.raises(TypeError, match="no text"):
        text_of(_uses(object(), 1.0))


@pytest.mark.usefixtures("store")
def test_a_parallel_kernel_runs_every_turn() -> None:
    @parallel_kernel
    def halves(x, out, call):
        for i in share_of(len(x), call):
            out[i] = 0.5 * x[i]

    x = np.arange(101, dtype=np.float32)
    for turns in (1, 2, 5):
        out = np.full(101, np.nan, np.float32)
        halves(x, out, turns=turns)
        np.testing.assert_array_equal(out, 0.5 * x)


WORK = """
import sys
from engine.formats import read_model
from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import profile
from engine.flows.records.opened_record import open_record
from engine.flows.verify.search import verify_images, verify_model
from engine.flows.warmup.kernel_warmup import warm_up
from engine.raster import render
from engine.watermark.keys import OwnerKey
if sys.argv[2] == "warm":
    warm_up("main")
    sys.exit()
sys.modules["numba"] = None  # an import of it fails
loaded, key = read_model(sys.argv[1]), OwnerKey(bytes(range(32)))
config = profile("fast", landmark_views=4, views=2, view_size=128)
made = embed(loaded.model, key, original_sha256=loaded.sha256, config=config)
opened = open_record(made.record.to_bytes(key), key)
verify_model(made.model, opened)
verify_images([render(made.model, opened.cameras[0])], opened)
"""


def test_the_usual_work_does_without_numba() -> None:
    """Once its kernels are kept."""
    model = Path(__file__).parents[1] / "data" / "train_1000.ply"
    for what in ("warm", "work"):
        run = [sys.executable, "-c", WORK, str(model), what]
        done = subprocess.run(run, capture_output=True, text=True, check=False, cwd=model.parents[2])
        assert done.returncode == 0, done.stderr


PIECE = """
from engine.kernels.jit import inlined
@inlined
def piece(x):
    return x + {}
"""
KERNELS = """
from engine.kernels.jit import kernel
from piece import piece
@kernel
def inner(x):
    return piece(x)
@kernel
def outer(x):
    return 10 * inner(x)
print(outer(1))
"""


@pytest.mark.long
def test_a_kernel_that_calls_a_kernel_sees_what_that_is_made_of(tmp_path: Path) -> None:
    """A piece in another file changes; the files of both kernels, whose dates numba's cache goes by, do not."""
    (tmp_path / "kernels.py").write_text(KERNELS)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(Path.cwd())}
    said = []
    for number in (1, 2):
        (tmp_path / "piece.py").write_text(PIECE.format(number))
        run = [sys.executable, "-B", str(tmp_path / "kernels.py")]
        said.append(subprocess.run(run, env=environment, capture_output=True, text=True, check=True).stdout)
    assert said == ["20\n", "30\n"]


@pytest.mark.usefixtures("store")
def test_what_is_not_kept_is_not_compiled_at_every_call(compiled: list[str]) -> None:
    @kernel
    def nested(x):
        return (x, (x, x))

    assert [nested(1), nested(2)] == [(1, (1, 1)), (2, (2, 2))]
    assert compiled.count("compiled") == len(compiled) <= 2  # by us, and by numba
    before = len(compiled)
    assert nested(3) == (3, (3, 3))
    assert len(compiled) == before
