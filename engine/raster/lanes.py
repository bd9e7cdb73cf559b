"""Sixteen float32 lanes as one value inside numba kernels.

A numba type whose data model is an LLVM ``<16 x float>`` with the usual operators, a mask type with it, and
the few operations a rasterizer needs. LLVM maps it to one AVX-512 register, or splits it into two or four
narrower ones (AVX2, SSE, Arm). Floating-point freedoms are `FLOAT_FLAGS`; `exp2` works without any, because
freedom to re-associate would cancel its rounding constant.
"""

# mypy: allow-untyped-decorators, allow-subclassing-any, allow-untyped-calls
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from engine.numerics.jit import FLOAT_FLAGS

LANES = 16
FLAGS = tuple(sorted(FLOAT_FLAGS))

FLOAT = ir.FloatType()
INT32 = ir.IntType(32)
FLOATS = ir.VectorType(FLOAT, LANES)
INTS = ir.VectorType(INT32, LANES)
BOOLS = ir.VectorType(ir.IntType(1), LANES)


class LanesType(types.Type):
    """16 x float32."""

    def __init__(self) -> None:
        super().__init__(name="lanes16xf32")


class MaskType(types.Type):
    """16 x bool."""

    def __init__(self) -> None:
        super().__init__(name="mask16")


lanes = LanesType()
mask = MaskType()


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, type_: Any) -> None:
        super().__init__(manager, type_, FLOATS)


@register_model(MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager: Any, type_: Any) -> None:
        super().__init__(manager, type_, BOOLS)


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
    return b.shuffle_vector(first, undefined, ints(0))


def call_llvm(b: Any, name: str, result: Any, arguments: list[Any], fast: bool = False) -> Any:
    """IR: call of an LLVM intrinsic."""
    kind = ir.FunctionType(result, [a.type for a in arguments])
    function = cgutils.get_or_insert_function(b.module, kind, name)
    return b.call(function, arguments, fastmath=FLAGS if fast else ())


# --- operators: lanes with lanes, or with a float32 scalar
# ---------------------------------------------------------

_PAIRS = ((lanes, lanes), (lanes, types.float32), (types.float32, lanes))


def _operands(b: Any, sig: Any, args: Any) -> list[Any]:
    return [broadcast(b, a) if t == types.float32 else a for t, a in zip(sig.args, args, strict=True)]


def _define(symbol: Any, result: Any, emit: Callable[..., Any]) -> None:
    @infer_global(symbol)
    class _Template(ConcreteTemplate):
        cases = [signature(result, *pair) for pair in _PAIRS]  # noqa: RUF012

    def lower(context: Any, b: Any, sig: Any, args: Any) -> Any:
        return emit(b, *_operands(b, sig, args))

    for pair in _PAIRS:
        lower_builtin(symbol, *pair)(lower)


def _arithmetic(opcode: str) -> Callable[..., Any]:
    return lambda b, x, y: getattr(b, opcode)(x, y, flags=FLAGS)


def _comparison(symbol: str) -> Callable[..., Any]:
    return lambda b, x, y: b.fcmp_ordered(symbol, x, y)


for _symbol, _opcode in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
    (operator.iadd, "fadd"),
    (operator.isub, "fsub"),
    (operator.imul, "fmul"),
):
    _define(_symbol, lanes, _arithmetic(_opcode))
for _symbol, _compare in ((operator.ge, ">="), (operator.gt, ">"), (operator.le, "<="), (operator.lt, "<")):
    _define(_symbol, mask, _comparison(_compare))


def _define_mask(symbol: Any, opcode: str) -> None:
    @infer_global(symbol)
    class _Template(ConcreteTemplate):
        cases = [signature(mask, mask, mask)]  # noqa: RUF012

    lower_builtin(symbol, mask, mask)(lambda context, b, sig, args: getattr(b, opcode)(*args))


_define_mask(operator.and_, "and_")
_define_mask(operator.or_, "or_")


@infer_global(operator.neg)
class _Negation(ConcreteTemplate):
    cases = [signature(lanes, lanes)]  # noqa: RUF012


lower_builtin(operator.neg, lanes)(lambda context, b, sig, args: b.fneg(args[0], flags=FLAGS))

# --- elementary operations
# -----------------------------------------------------------------------------------------


@intrinsic
def spread(typing: Any, x: Any) -> Any:
    """A float32 in every lane."""
    return lanes(types.float32), lambda context, b, sig, args: broadcast(b, args[0])


@intrinsic
def fma(typing: Any, x: Any, y: Any, z: Any) -> Any:
    """x * y + z in one rounding; each of the three may be a float32 scalar."""

    def emit(context: Any, b: Any, sig: Any, args: Any) -> Any:
        return fused(b, *_operands(b, sig, args))

    return lanes(*(lanes if t == lanes else types.float32 for t in (x, y, z))), emit


def fused(b: Any, x: Any, y: Any, z: Any) -> Any:
    """IR: x * y + z."""
    return call_llvm(b, f"llvm.fma.v{LANES}f32", FLOATS, [x, y, z], fast=True)


def _pick(symbol: str) -> Any:
    @intrinsic
    def pick(typing: Any, x: Any, y: Any) -> Any:
        def emit(context: Any, b: Any, sig: Any, args: Any) -> Any:
            left, right = _operands(b, sig, args)
            return b.select(b.fcmp_ordered(symbol, left, right), left, right)

        return lanes(*(lanes if t == lanes else types.float32 for t in (x, y))), emit

    return pick


minimum = _pick("<")
maximum = _pick(">")


@intrinsic
def select(typing: Any, condition: Any, x: Any, y: Any) -> Any:
    """x where the condition holds, else y."""
    return lanes(mask, lanes, lanes), lambda context, b, sig, args: b.select(*args)


@intrinsic
def bits_of(typing: Any, condition: Any) -> Any:
    """The mask as the low 16 bits of an int32, lane 0 first."""

    def emit(context: Any, b: Any, sig: Any, args: Any) -> Any:
        return b.zext(b.bitcast(args[0], ir.IntType(LANES)), INT32)

    return types.int32(mask), emit


@intrinsic
def minus_magnitude(typing: Any, x: Any) -> Any:
    """-|x|: sets the sign bit."""

    def emit(context: Any, b: Any, sig: Any, args: Any) -> Any:
        return b.bitcast(b.or_(b.bitcast(args[0], INTS), ints(-(2**31))), FLOATS)

    return lanes(lanes), emit


def _unary(name: str) -> Any:
    @intrinsic
    def function(typing: Any, x: Any) -> Any:
        def emit(context: Any, b: Any, sig: Any, args: Any) -> Any:
            return call_llvm(b, f"llvm.{name}.v{LANES}f32", FLOATS, [args[0]], fast=True)

        return lanes(lanes), emit

    return function


root = _unary("sqrt")
round_down = _unary("floor")


def constant_lanes(values: list[float]) -> Any:
    """A function without arguments that returns these 16 numbers."""

    @intrinsic
    def function(typing: Any) -> Any:
        return lanes(), lambda context, b, sig, args: ir.Constant(FLOATS, [float(v) for v in values])

    return function
