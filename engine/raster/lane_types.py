"""The types of lanes and masks as numba knows them, their operators, and intrinsics of them: imported to compile."""

# mypy: allow-untyped-defs, allow-untyped-decorators, allow-subclassing-any, allow-untyped-calls
import inspect
import operator
from collections.abc import Callable
from typing import Any

from numba import types
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from engine.raster.lane_ir import BOOLS, FLAGS, FLOATS, broadcast


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


def kind(name: Any) -> Any:
    """A type by its name in `lanes`."""
    if isinstance(name, tuple):
        return types.UniTuple(kind(name[0]), name[1])
    return {"lanes": lanes, "mask": mask}.get(name) or getattr(types, name)


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


def _make_intrinsic(typing: Callable[..., Any], lower: Callable[..., Any], emit: Callable[..., Any]) -> Any:
    """A numba intrinsic of types and lowering that carries the name, the words and the signature of `emit`."""

    def typed(context: Any, *types_: Any) -> Any:
        return typing(*types_), lower

    typed.__name__, typed.__doc__ = emit.__name__, emit.__doc__
    typed.__signature__ = inspect.signature(emit)  # type: ignore[attr-defined]  # how numba learns the parameters
    return intrinsic(typed)


def function_of(emit: Callable[..., Any], result: Any, arguments: tuple[Any, ...]) -> Any:
    """See `lanes.ir_function`."""
    given = kind(result)(*map(kind, arguments))
    return _make_intrinsic(lambda *_: given, lambda context, b, sig, args: emit(b, *args), emit)


def mixed_function_of(emit: Callable[..., Any]) -> Any:
    """See `lanes.mixed`."""
    return _make_intrinsic(
        lambda *given: lanes(*(lanes if t == lanes else types.float32 for t in given)),
        lambda context, b, sig, args: emit(b, *_operands(b, sig, args)),
        emit,
    )


def array_function_of(emit: Callable[..., Any], result: Any, arguments: tuple[Any, ...]) -> Any:
    """See `lane_memory.on_array`."""
    gives, kinds = kind(result), [name if name is None else kind(name) for name in arguments]

    def lower(context: Any, b: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(sig.args[0])(context, b, args[0]).data
        pairs = zip(sig.args[1:], args[1:], strict=True)
        values = [len(kind) if isinstance(kind, types.BaseTuple) else value for kind, value in pairs]
        out = emit(b, lambda index: b.gep(data, [index]), *values)
        return context.get_dummy_value() if gives is types.void else out

    def typing(array: Any, *given: Any) -> Any:
        return gives(array, *(g if t is None else t for t, g in zip(kinds, given, strict=True)))

    return _make_intrinsic(typing, lower, emit)
