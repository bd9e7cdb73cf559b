"""Sixteen float32 lanes as one value inside numba kernels.

A numba type whose data model is an LLVM ``<16 x float>`` with the usual operators, a mask type with it, and
the few operations a rasterizer needs. LLVM maps it to one AVX-512 register, or splits it into two or four
narrower ones (AVX2, SSE, Arm). Floating-point freedoms are `FLOAT_FLAGS`; `exp2` works without any, because
freedom to re-associate would cancel its rounding constant.
"""

# mypy: allow-untyped-defs, allow-untyped-decorators, allow-subclassing-any, allow-untyped-calls
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

from llvmlite import ir

from engine.kernels.deferred import Deferred
from engine.raster.lane_ir import FLOATS, INT32, INTS, LANES, broadcast, call_llvm, ints

# Types of kernels by their names, as `lane_types` knows them: "float32", "int32", "int64", "intp", "void", these two,
# and (name, count) of a tuple. So nothing here needs numba before something is compiled.
lanes, mask = "lanes", "mask"
TYPES = sha256(Path(__file__).with_name("lane_types.py").read_bytes()).hexdigest()
"""What code of kernels depends on in addition to its own text."""


def ir_function(result: Any, *arguments: Any) -> Callable[..., Deferred]:
    """Decorator: an intrinsic of these types out of a function that emits its IR from the builder and the values."""

    def decorate(emit: Callable[..., Any]) -> Deferred:
        def compiled() -> Any:
            from engine.raster.lane_types import function_of

            return function_of(emit, result, arguments)

        return Deferred(emit, compiled, (result, arguments, TYPES))

    return decorate


def mixed(emit: Callable[..., Any]) -> Deferred:
    """Decorator: as `ir_function`, of lanes to lanes; each argument may also be a float32 scalar."""

    def compiled() -> Any:
        from engine.raster.lane_types import mixed_function_of

        return mixed_function_of(emit)

    return Deferred(emit, compiled, ("mixed", TYPES))


@ir_function(lanes, "float32")
def spread(b, x):
    """A float32 in every lane."""
    return broadcast(b, x)


def fused(b: Any, x: Any, y: Any, z: Any) -> Any:
    """IR: x * y + z."""
    return call_llvm(b, f"llvm.fma.v{LANES}f32", FLOATS, [x, y, z], fast=True)


@mixed
def fma(b, x, y, z):
    """x * y + z in one rounding."""
    return fused(b, x, y, z)


@mixed
def minimum(b, x, y):
    """The smaller; y where either is NaN."""
    return b.select(b.fcmp_ordered("<", x, y), x, y)


@mixed
def maximum(b, x, y):
    """The larger; y where either is NaN."""
    return b.select(b.fcmp_ordered(">", x, y), x, y)


@ir_function(lanes, mask, lanes, lanes)
def select(b, condition, x, y):
    """x where the condition holds, else y."""
    return b.select(condition, x, y)


@ir_function("int32", mask)
def bits_of(b, condition):
    """The mask as the low 16 bits of an int32, lane 0 first."""
    return b.zext(b.bitcast(condition, ir.IntType(LANES)), INT32)


@ir_function(lanes, lanes)
def magnitude(b, x):
    """|x|: clears the sign bit."""
    return b.bitcast(b.and_(b.bitcast(x, INTS), ints(2**31 - 1)), FLOATS)


@ir_function(lanes, lanes)
def minus_magnitude(b, x):
    """-|x|: sets the sign bit."""
    return b.bitcast(b.or_(b.bitcast(x, INTS), ints(-(2**31))), FLOATS)


@ir_function(lanes, lanes)
def root(b, x):
    """Square root."""
    return call_llvm(b, f"llvm.sqrt.v{LANES}f32", FLOATS, [x], fast=True)


@ir_function(lanes, lanes)
def round_down(b, x):
    """The largest integer that is no larger."""
    return call_llvm(b, f"llvm.floor.v{LANES}f32", FLOATS, [x], fast=True)


def constant_lanes(values: list[float]) -> Any:
    """A function without arguments that returns these 16 numbers."""

    @ir_function(lanes)
    def function(b):
        return ir.Constant(FLOATS, [float(v) for v in values])

    return function
