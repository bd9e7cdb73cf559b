"""What kernels are made of, plain Python until compiled: its text, by which kept code is known, and its names."""

import hashlib
from collections.abc import Callable, Iterator
from types import BuiltinFunctionType, CellType, CodeType, FunctionType, MethodDescriptorType, ModuleType
from typing import Any

import numpy as np


class Deferred:
    """A piece of kernels: `compiled` is what the compiler sees where a kernel names it, made at its first use."""

    def __init__(self, function: Callable[..., Any], make: Callable[[], Any], facts: tuple[Any, ...] = ()) -> None:
        """`facts`: what code depends on in addition to the function's text."""
        self.function = function
        self.facts = facts
        self._make = make
        self._compiled: Any = None
        self.__doc__, self.__name__, self.__module__ = function.__doc__, function.__name__, function.__module__

    def compiled(self) -> Any:
        """Numba's object."""
        if self._compiled is None:
            self._compiled = self._make()
        return self._compiled

    def __call__(self, *arguments: Any) -> Any:
        """Call it from Python, which is of use in tests."""
        return self.compiled()(*arguments)


def resolved(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function with all that is deferred among the names it uses replaced by the compiler's objects."""
    assert isinstance(function, FunctionType)
    names = function.__globals__ | {n: v.compiled() for n, v in _used(function) if isinstance(v, Deferred)}
    cells = tuple(_resolved_cell(cell) for cell in function.__closure__ or ()) or None
    made = FunctionType(function.__code__, names, function.__name__, function.__defaults__, cells)
    made.__qualname__, made.__module__, made.__doc__ = function.__qualname__, function.__module__, function.__doc__
    return made


def _resolved_cell(cell: CellType) -> CellType:
    held = cell.cell_contents
    return CellType(held.compiled()) if isinstance(held, Deferred) else cell


def text_of(function: Callable[..., Any]) -> str:
    """A digest of all that the code of a function depends on: its instructions, constants and names, and the same of
    every function that it names. TypeError where it names what has no text."""
    digest = hashlib.sha256()
    for part in _parts(function, set()):
        digest.update(part.encode() + b"\0")
    return digest.hexdigest()


def _used(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Names of the module that a function uses, in its own code or in code within, with their values."""
    names: dict[str, None] = {}
    waiting = [function.__code__]
    while waiting:
        code = waiting.pop()
        names.update(dict.fromkeys(code.co_names))
        waiting += [each for each in code.co_consts if isinstance(each, CodeType)]
    return ((name, function.__globals__[name]) for name in names if name in function.__globals__)


def _parts(value: Any, seen: set[int]) -> Iterator[str]:
    """What the text of a kernel says of a value that it names; `seen`: functions that are said already."""
    if isinstance(value, Deferred):
        yield from _parts(value.facts, seen)
        value = value.function
    if isinstance(value, dict):
        value = list(value.items())
    if isinstance(value, FunctionType):
        yield from ("again",) if id(value) in seen else _function(value, seen)
    elif isinstance(value, tuple | list):
        yield f"{type(value).__name__} of {len(value)}"
        for each in value:
            yield from _parts(each, seen)
    else:
        yield _constant(value)


def _function(function: FunctionType, seen: set[int]) -> Iterator[str]:
    seen.add(id(function))
    yield f"function {function.__qualname__}"
    yield from _code(function.__code__)
    for name, value in _used(function):
        yield f"name {name}"
        yield from _parts(value, seen)
    for cell in function.__closure__ or ():
        yield from _parts(cell.cell_contents, seen)
    yield from _parts(function.__defaults__ or (), seen)


def _code(code: CodeType) -> Iterator[str]:
    yield code.co_code.hex()
    yield repr((code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars, code.co_argcount))
    for each in code.co_consts:
        yield from _code(each) if isinstance(each, CodeType) else (_literal(each),)


def _constant(value: Any) -> str:
    """One line of text for anything else that a kernel may name; TypeError where there is none."""
    if isinstance(value, np.ndarray):
        return f"array {value.dtype} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, bool | int | float | complex | str | bytes | np.generic | None | frozenset | slice):
        return _literal(value)
    if isinstance(value, ModuleType | type | BuiltinFunctionType | MethodDescriptorType | np.ufunc):
        return f"{type(value).__name__} {getattr(value, '__module__', '')} {value.__name__}"
    if type(value).__module__.startswith("llvmlite."):
        return str(value)
    if (type(value).__module__ == "typing" or callable(value)) and " at 0x" not in repr(value):
        return _literal(value)
    raise TypeError(f"a kernel names {value!r}, of which there is no text to know its code by")


def _literal(value: Any) -> str:
    return f"{type(value).__name__} {sorted(map(repr, value)) if isinstance(value, frozenset) else repr(value)}"
