"""Sixteen float32 lanes as one value inside numba kernels.

A numba type whose data model is an LLVM ``<16 x float>`` with the usual operators, a mask type with it, and
the few operations a rasterizer needs. LLVM maps it to one AVX-512 register, or splits it into two or four
narrower ones (AVX2, SSE, Arm). Floating-point freedoms are `FLOAT_FLAGS`; `exp2` works without any, because
freedom to re-associate would cancel its rounding constant.
"""

# mypy: allow-untyped-defs, allow-untyped-decorators, allow-subclassing-any, allow-untyped-calls
import inspect
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import binding, ir
from numba import types
from numba.core import cgutils, config
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from engine.numerics.jit import FLOAT_FLAGS

LANES = 16

_FEATURES = config.CPU_FEATURES or binding.get_host_cpu_features().flatten()
REGISTER = next((size for feature, size in {"+avx512f": 16, "+avx": 8}.items() if feature in _FEATURES.split(",")), 4)
"""Lanes that one register of this processor holds, or of the one that numba was told to compile for."""

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
    return b.shuffle_vector(first, undefined, ir.Constant(ir.VectorType(INT32, vector.count), [0] * vector.count))


def call_llvm(b: Any, name: str, result: Any, arguments: list[Any], fast: bool = False) -> Any:
    """IR: call of an LLVM intrinsic."""
    kind = ir.FunctionType(result, [a.type for a in arguments])
    function = cgutils.get_or_insert_function(b.module, kind, name)
    return b.call(function, arguments, fastmath=FLAGS if fast else ())


# --- operators: lanes with lanes, or with a float32 scalar

_PAIRS = ((lanes, lanes), (lanes, types.float32), (types.float32, lanes))


def _operands(b: Any, sig: Any, args: Any) -> list[Any]:
    return [broadcast(b, a) if t == types.float32 else a for t, a in zip(sig.args, args, strict=True)]


def _define(symbol: Any, result: Any, operands: tuple[tuple[Any, ...], ...], emit: Callable[..., Any]) -> None:
    @infer_global(symbol)
    class _Template(ConcreteTemplate):
        cases = [signature(result, *types_) for types_ in operands]  # noqa: RUF012 (numba reads it so)

    for types_ in operands:
        lower_builtin(symbol, *types_)(lambda context, b, sig, args: emit(b, *_operands(b, sig, args)))


def _arithmetic(opcode: str) -> Callable[..., Any]:
    return lambda b, *operands: getattr(b, opcode)(*operands, flags=FLAGS)


def _comparison(symbol: str) -> Callable[..., Any]:
    return lambda b, x, y: b.fcmp_ordered(symbol, x, y)


for _name, _opcode in {"add": "fadd", "sub": "fsub", "mul": "fmul", "truediv": "fdiv"}.items():
    _define(getattr(operator, _name), lanes, _PAIRS, _arithmetic(_opcode))
for _name in ("add", "sub", "mul"):
    _define(getattr(operator, f"i{_name}"), lanes, _PAIRS, _arithmetic(f"f{_name}"))
for _name, _symbol in {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}.items():
    _define(getattr(operator, _name), mask, _PAIRS, _comparison(_symbol))
_define(operator.and_, mask, ((mask, mask),), lambda b, x, y: b.and_(x, y))
_define(operator.or_, mask, ((mask, mask),), lambda b, x, y: b.or_(x, y))
_define(operator.neg, lanes, ((lanes,),), _arithmetic("fneg"))

# --- intrinsics


def make_intrinsic(typing: Callable[..., Any], lower: Callable[..., Any], emit: Callable[..., Any]) -> Any:
    """A numba intrinsic of types and lowering that carries the name, the words and the signature of `emit`."""

    def typed(context: Any, *types_: Any) -> Any:
        return typing(*types_), lower

    typed.__name__, typed.__doc__ = emit.__name__, emit.__doc__
    typed.__signature__ = inspect.signature(emit)  # type: ignore[attr-defined]  # how numba learns the parameters
    return intrinsic(typed)


def ir_function(result: Any, *arguments: Any) -> Callable[..., Any]:
    """Decorator: an intrinsic of these types out of a function that emits its IR from the builder and the values."""

    def decorate(emit: Callable[..., Any]) -> Any:
        return make_intrinsic(lambda *_: result(*arguments), lambda context, b, sig, args: emit(b, *args), emit)

    return decorate


def mixed(emit: Callable[..., Any]) -> Any:
    """Decorator: as `ir_function`, of lanes to lanes; each argument may also be a float32 scalar."""
    return make_intrinsic(
        lambda *given: lanes(*(lanes if t == lanes else types.float32 for t in given)),
        lambda context, b, sig, args: emit(b, *_operands(b, sig, args)),
        emit,
    )


@ir_function(lanes, types.float32)
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


@ir_function(types.int32, mask)
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
