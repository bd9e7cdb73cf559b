"""Machine code is called without numba only where that gives what numba gives."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from engine.errors import Mark3DGSError
from engine.kernels import compiler, kernel_cache, machine_code, native_check
from engine.kernels.jit import kernel
from engine.kernels.native_check import calls_native
from engine.kernels.native_probe import difference

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def _machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A machine on which nothing was compared yet."""
    monkeypatch.setattr(kernel_cache, "folders", lambda: (tmp_path,))
    monkeypatch.setattr(kernel_cache, "folder", lambda: tmp_path)
    for name in ("MARK3DGS_KERNELS", "MARK3DGS_WARNED_KERNELS"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    calls_native.cache_clear()
    monkeypatch.setattr(native_check, "calls_native", calls_native)
    yield
    calls_native.cache_clear()


def test_here_both_ways_agree_and_it_is_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    assert difference() == ""
    assert calls_native()
    calls_native.cache_clear()
    monkeypatch.setattr(native_check, "_ask", lambda: pytest.fail("compared again"))
    assert calls_native()


def _changed(change: Any) -> Any:
    load = machine_code.load

    def patched(code: machine_code.Code) -> Any:
        native = load(code)
        assert native is not None
        return lambda *arguments: change(native, arguments)

    return patched


def _other_number(native: Any, arguments: tuple[Any, ...]) -> Any:
    total, *rest = native(*arguments)
    return total + 1e-12, *rest


def _write_outside(native: Any, arguments: tuple[Any, ...]) -> Any:
    arrays = [at for at, each in enumerate(arguments) if each is None and arguments[at + 1 : at + 2] == (None,)]
    out = arguments[arrays[5] + 4]  # the address of the sixth array, which is written to
    ctypes.c_float.from_address(out - 4).value = 9.0
    return native(*arguments)


def _skip_a_turn(native: Any, arguments: tuple[Any, ...]) -> Any:
    return native(*arguments[:-2], 0, arguments[-1])


@pytest.mark.parametrize("change", [_other_number, _write_outside, _skip_a_turn])
def test_other_results_or_writes_are_a_difference(monkeypatch: pytest.MonkeyPatch, change: Any) -> None:
    monkeypatch.setattr(machine_code, "load", _changed(change))
    assert "other results" in difference()


def test_what_cannot_be_loaded_is_a_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine_code, "load", lambda code: None)
    assert difference()


def run_by_numba() -> None:
    @kernel
    def doubled(x):
        return 2 * x

    assert doubled(4) == 8
    assert doubled._natives == {"(<i8)": None}


@pytest.mark.parametrize(
    "program", ["print('they differ', end='')", "import os; os.kill(os.getpid(), 11)", "raise SystemExit(3)"]
)
def test_where_they_differ_numba_runs_every_kernel_and_it_is_told_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, program: str
) -> None:
    """Also where the check itself crashes, as a wrong call of machine code would."""
    monkeypatch.setattr(native_check, "module_command", lambda name: [sys.executable, "-c", program])
    run_by_numba()
    calls_native.cache_clear()
    monkeypatch.setattr(native_check, "_ask", lambda: pytest.fail("compared again"))
    run_by_numba()
    assert len(caplog.records) == 1


@pytest.mark.parametrize(
    "command", [[os.devnull + "/nothing"], [sys.executable, "-c", "import os; os.kill(os.getpid(), 9)"]]
)
def test_a_check_that_could_not_end_is_made_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, command: list[str]
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(native_check, "module_command", lambda name: command)
        run_by_numba()
    assert not list(tmp_path.glob("*.verdict"))
    calls_native.cache_clear()
    assert calls_native()


PROGRAM = """
import sys
import numba.core.compiler_lock
del numba.core.compiler_lock.global_compiler_lock
sys.modules["numba.core.event"] = None
{}
"""


def test_without_numbas_internals_numba_runs_every_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    check = PROGRAM.format("import runpy; runpy.run_module('engine.kernels.native_probe', run_name='__main__')")
    monkeypatch.setattr(native_check, "module_command", lambda name: [sys.executable, "-c", check])
    monkeypatch.chdir(ROOT)
    assert "internals" in native_check.verdict()
    run_by_numba()
    monkeypatch.setattr(compiler, "compile_kernel", lambda *_: pytest.fail("by numba's internals"))
    run_by_numba()


@pytest.mark.parametrize("version", ["0.69.0", "0.69.0rc1", "1.0", "0.70.0dev0+12.g1234567"])
def test_a_numba_that_nobody_tried_runs_every_kernel_itself(monkeypatch: pytest.MonkeyPatch, version: str) -> None:
    facts = [version, *kernel_cache.compiler()[1:]]
    monkeypatch.setattr(kernel_cache, "compiler", lambda: facts)
    assert version in native_check.verdict()
    run_by_numba()


def test_the_variable_switches_it_off(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setenv("MARK3DGS_KERNELS", "numba")
    run_by_numba()
    assert not caplog.records
    monkeypatch.setenv("MARK3DGS_KERNELS", "auto")
    calls_native.cache_clear()
    assert calls_native()


def test_another_value_of_the_variable_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MARK3DGS_KERNELS", "natvie")
    with pytest.raises(Mark3DGSError, match=r"MARK3DGS_KERNELS.*'natvie'.*'auto'.*'numba'"):
        kernel(lambda x: x)(1)


TWICE = """
import sys
from engine.kernels import machine_code
from engine.kernels.jit import kernel
from piece import piece
compiled = []
machine_code.on_compiling.append(lambda: compiled.append(1))
@kernel
def f(x):
    return piece(x)
print(f(1), len(compiled) > 0)
"""


@pytest.mark.long
def test_numba_keeps_what_it_runs_and_never_what_is_out_of_date(tmp_path: Path) -> None:
    (tmp_path / "kernels.py").write_text(TWICE)
    environment = {**os.environ, "MARK3DGS_KERNELS": "numba", "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    environment["PYTHONPATH"] = str(ROOT)
    said = []
    for number in (1, 1, 2):
        (tmp_path / "piece.py").write_text(
            f"from engine.kernels.jit import inlined\n@inlined\ndef piece(x):\n    return x + {number}\n"
        )
        run = [sys.executable, "-B", str(tmp_path / "kernels.py")]
        said.append(subprocess.run(run, env=environment, capture_output=True, text=True, check=True).stdout)
    assert said == ["2 True\n", "2 False\n", "3 True\n"]
