"""Kernels compiled by numba: imported where one is not kept as machine code yet, or makes arrays of its own."""

# mypy: allow-untyped-calls, disable-error-code=no-any-return

import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
from numba.extending import register_jitable

from engine.kernels.machine_code import Code, announce

_OPTIONS: dict[str, bool | str] = {
    "boundscheck": False,
    "error_model": "numpy",  # no division-by-zero checks: they stop vectorization
}
_setting = threading.Lock()


def dispatcher(function: Callable[..., Any], flags: frozenset[str], allocates: bool, place: Path | None = None) -> Any:
    """Numba's own callable, kept in such a folder where one can be made."""
    options = {"nogil": True, "fastmath": set(flags), "_nrt": allocates, **_OPTIONS}
    made = numba.njit(**options)(function)
    if place is not None:
        with _setting, suppress(RuntimeError):  # numba's, where it can keep nothing: no folder, or no source file
            before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(place)
            try:
                made.enable_caching()
            finally:
                numba.config.CACHE_DIR = before
    return made


def inlined_function(function: Callable[..., Any], flags: frozenset[str], allocates: bool) -> Any:
    """What LLVM puts in wherever it is called."""
    return numba.njit(forceinline=True, fastmath=set(flags), _nrt=allocates, **_OPTIONS)(function)


def plain_function(function: Callable[..., Any]) -> Any:
    """What is compiled with the options of whoever calls it, and put in."""
    return register_jitable(forceinline=True)(function)


def compile_kernel(function: Callable[..., Any], flags: frozenset[str], arguments: tuple[Any, ...]) -> Code | None:
    """Code of a kernel for such arguments; None where it gives back more than numbers."""
    from numba.core import types
    from numba.core.compiler_lock import global_compiler_lock

    made = numba.njit(
        nogil=True, fastmath=set(flags), _nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True, **_OPTIONS
    )(function)
    with global_compiler_lock:
        found = made._compiler.compile(tuple(numba.typeof(each) for each in arguments), None)
        kind = found.signature.return_type
        several = isinstance(kind, types.containers.BaseTuple)
        members = list(kind.types) if several else [] if kind == types.none else [kind]
        if not all(isinstance(each, types.Number | types.Boolean) for each in members):
            return None
        library, name = found.library, found.fndesc.llvm_func_name
        returns = [str(found.target_context.get_data_type(each)) for each in members]
        module = library._final_module
        native = module.get_function(name)
        called = {_c_name(each.name) for each in module.functions if each.is_declaration} - {""}
        kinds = [str(each.type) for each in native.arguments][2:]
        machine = library._codegen._tm.emit_object(module)
    single = bool(members) and not several
    return Code(name, kinds, returns, single, sorted(called), machine)


_OF_C = {"cos", "exp", "exp2", "fmod", "log", "log10", "log2", "pow", "sin", "tan"}


def _c_name(declared: str) -> str:
    """The function of the C library that a declared one stands for; empty for what is an instruction."""
    if not declared.startswith("llvm."):
        return declared
    _, name, *kind = declared.split(".")
    return name + {"f64": "", "f32": "f"}.get(kind[-1], "") if kind and name in _OF_C else ""


def _announce_numbas() -> None:
    from numba.core import event

    class Listener(event.Listener):  # type: ignore[misc]  # numba is untyped
        def on_start(self, event: Any) -> None:
            announce()

        def on_end(self, event: Any) -> None:
            pass

    event.register("numba:compile", Listener())  # of what numba keeps itself


with suppress(ImportError, AttributeError):  # numba's internals: without them a wait is not announced
    _announce_numbas()
