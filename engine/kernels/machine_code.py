"""Machine code of kernels in files, loaded and called without numba.

Numba takes a quarter of a second to import, a third to set itself up at the first kernel, and five milliseconds for
each that it finds in its cache; a command of a few seconds calls fifty. So what it compiled is kept as the object file
that LLVM made, loaded by LLVM alone in a fifth of a millisecond, and called by its address. `compiler` makes it.

A kernel's code depends on nothing but its own text, that of all it calls, the types of its arguments and the
processor, which name its file (`kernel_cache`). Before code is called this way, `native_check` compares it with numba.
"""

import ctypes
import os
import threading
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

_C_TYPES: dict[str, Any] = {
    "ptr": ctypes.c_void_p,
    "double": ctypes.c_double,
    "float": ctypes.c_float,
    "i1": ctypes.c_bool,
    "i8": ctypes.c_int8,
    "i16": ctypes.c_int16,
    "i32": ctypes.c_int32,
    "i64": ctypes.c_int64,
}
_DONE = (0, -2)
"""What a kernel says when it is through, with a value or None."""

Native = Callable[..., Any]
"""A compiled kernel: takes what `flatten` gives."""


on_compiling: list[Callable[[], None]] = []
"""Called before a kernel is compiled that was not kept."""


def announce() -> None:
    """A kernel is about to be compiled."""
    for tell in list(on_compiling):
        tell()


class Code(NamedTuple):
    """One kernel for one set of argument types."""

    name: str  # of the function in the object file
    arguments: list[str]  # LLVM types
    returns: list[str]  # LLVM types of the numbers that are given back; none where nothing is, `single` for a bare one
    single: bool
    symbols: list[str]  # of the C library that it calls
    machine: bytes  # the object file


def kind_of(value: Any) -> str | None:
    """The type of an argument, as far as code depends on it; None where numba alone knows what to do with it."""
    if isinstance(value, np.ndarray):
        form = value.dtype, value.ndim, value.flags.num  # of a handful: to spell it out takes longer than to look it up
        if form not in _array_kinds:
            _array_kinds[form] = _array_kind(value)
        return _array_kinds[form]
    if isinstance(value, tuple):
        inside = [kind_of(each) for each in value]
        return None if None in inside else f"({','.join(inside)})"  # type: ignore[arg-type]
    if type(value) is int:  # not a bool
        return "<i8" if -(2**63) <= value < 2**63 else None
    if value is None or isinstance(value, bool | np.bool_):
        return "-" if value is None else "?"
    if isinstance(value, np.generic):
        return value.dtype.str if value.dtype.kind in "iuf" else None
    return "<f8" if isinstance(value, float) else None


_array_kinds: dict[tuple[np.dtype[Any], int, int], str | None] = {}


def _array_kind(array: np.ndarray[Any, Any]) -> str | None:
    flags = array.flags
    layout = "C" if flags.c_contiguous else "F" if flags.f_contiguous else "A"
    held = ("" if flags.writeable else "r") + ("" if flags.aligned else "u")
    return None if array.dtype.hasobject or array.dtype.names else f"{array.dtype.str}{array.ndim}{layout}{held}"


def flatten(values: Sequence[Any], out: list[Any]) -> list[Any]:
    """Append what numba's calls pass for these arguments: arrays as two owners, of which there are none, size, item
    size, address, shape and strides; tuples as their members; None as no address."""
    for value in values:
        if isinstance(value, np.ndarray):
            try:
                address = ctypes.addressof(ctypes.c_char.from_buffer(value.data))
            except (TypeError, ValueError):  # it is empty, may not be written, or has gaps: this takes longer
                address = value.__array_interface__["data"][0]
            out += (None, None, value.size, value.itemsize, address, *value.shape, *value.strides)
        elif isinstance(value, tuple):
            flatten(value, out)
        else:
            out.append(value.item() if isinstance(value, np.generic) else value)
    return out


@cache
def processor() -> tuple[str, str]:
    """Name and features for which kernels are compiled: this machine's, unless numba was told others."""
    import llvmlite.binding as llvm

    name = os.environ.get("NUMBA_CPU_NAME") or llvm.get_host_cpu_name()
    return name, os.environ.get("NUMBA_CPU_FEATURES") or llvm.get_host_cpu_features().flatten()


_lock = threading.Lock()


@cache
def _engine() -> Any:
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine()
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)


def load(code: Code) -> Native | None:
    """The kernel as a function that lets go of Python's lock; None where numba must run it, because this process lacks
    something it calls or a type is passed in a way that is not known here."""
    import llvmlite.binding as llvm

    if not {*code.arguments, *code.returns} <= _C_TYPES.keys():
        return None
    with _lock:
        engine = _engine()  # which lets LLVM see what this process has loaded
        if not all(llvm.address_of_symbol(name) for name in code.symbols):
            return None
        engine.add_object_file(llvm.ObjectFileRef.from_data(code.machine))
        engine.finalize_object()
        address = engine.get_function_address(code.name)
    types = [_C_TYPES[each] for each in code.arguments]
    function = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p, *types)(address)

    class Given(ctypes.Structure):
        _fields_ = [(f"n{i}", _C_TYPES[each]) for i, each in enumerate(code.returns)]

    def call(*arguments: Any) -> Any:
        given, failed = Given(), ctypes.c_void_p()
        status = function(ctypes.byref(given), ctypes.byref(failed), *arguments)
        if status not in _DONE:
            raise RuntimeError(f"kernel {code.name} failed with status {status}")
        if not code.returns:
            return None
        numbers = tuple(getattr(given, name) for name, *_ in given._fields_)
        return numbers[0] if code.single else numbers

    return call
