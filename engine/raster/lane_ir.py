"""Sixteen lanes in LLVM's own words: types, constants, and how to call what it has."""

# mypy: allow-untyped-calls
from typing import Any

import numpy as np
from llvmlite import ir

from engine.kernels.jit import FLOAT_FLAGS
from engine.kernels.machine_code import processor

LANES = 16

_FEATURES = processor()[1].split(",")
REGISTER = next((size for feature, size in {"+avx512f": 16, "+avx": 8}.items() if feature in _FEATURES), 4)
"""Lanes that one register of the processor holds for which numba compiles, by default this one."""

FLAGS = tuple(sorted(FLOAT_FLAGS))

FLOAT = ir.FloatType()
INT32 = ir.IntType(32)
FLOATS = ir.VectorType(FLOAT, LANES)
INTS = ir.VectorType(INT32, LANES)
BOOLS = ir.VectorType(ir.IntType(1), LANES)


def floats(value: float) -> ir.Constant:
    """IR constant: the same number in every lane."""
    return ir.Constant(FLOATS, [float(np.float32(value))] * LANES)


def ints(value: int) -> ir.Constant:
    """IR constant: the same integer in every lane."""
    return ir.Constant(INTS, [value] * LANES)


def broadcast(b: Any, scalar: Any, vector: ir.VectorType = FLOATS) -> Any:
    """IR: one scalar to all lanes."""
    undefined = ir.Constant(vector, ir.Undefined)
    first = b.insert_element(undefined, scalar, ir.Constant(INT32, 0))
    return b.shuffle_vector(first, undefined, ir.Constant(ir.VectorType(INT32, vector.count), [0] * vector.count))


def call_llvm(b: Any, name: str, result: Any, arguments: list[Any], fast: bool = False) -> Any:
    """IR: call of an LLVM intrinsic."""
    kind = ir.FunctionType(result, [a.type for a in arguments])
    function = b.module.globals.get(name) or ir.Function(b.module, kind, name)
    return b.call(function, arguments, fastmath=FLAGS if fast else ())
