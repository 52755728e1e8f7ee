"""Eight numbers in the place of one: the types with which the text of a kernel moves eight filters at a time.

``Lanes`` is one number of each filter, as one vector. Arithmetic is done lane by lane and rounds as it does on single
numbers, so that each filter gets the bytes that it would get alone. Where a kernel decides something by a number, all
lanes must decide alike; where they do not, ``disagreements`` counts it, and whoever asked must do that step lane by
lane. ``where`` and ``everywhere`` are for decisions that may differ.
"""
# Numba passes compiler objects that have no types to check.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportUnknownParameterType=false, reportMissingParameterType=false, reportUnknownLambdaType=false
# pyright: reportMissingTypeStubs=false, reportIncompatibleMethodOverride=false, reportUntypedClassDecorator=false
# pyright: reportOptionalCall=false, reportAttributeAccessIssue=false

import math
import operator
from collections.abc import Callable
from typing import Any, Final, Protocol, cast

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typeconv.castgraph import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model

LINE: Final = 64  # bytes of a line of the cache
LANES: Final = 8  # filters that go together: a vector of the widest processors there are

_DOUBLE, _WORD, _BIT, _BYTE = ir.DoubleType(), ir.IntType(64), ir.IntType(1), ir.IntType(8)
_FLOATS, _INTS, _BITS = (ir.VectorType(one, LANES) for one in (_DOUBLE, _WORD, _BIT))
_COUNTER: Final = "fuselog_lanes_that_disagreed"


class _Vector(types.Type):
    """A number, or a truth, of each filter; one that is for all becomes one of each."""

    def __init__(self, name: str, single: types.Type, element: ir.Type) -> None:
        self.single, self.element = single, element
        super().__init__(name=name)

    def unify(self, _context: Any, other: types.Type) -> "types.Type | None":
        return self if isinstance(other, (types.Number, types.Boolean)) else None

    def can_convert_from(self, _context: Any, other: types.Type) -> Any:
        accepted = types.Boolean if self.single is types.boolean else types.Number
        return Conversion.safe if isinstance(other, accepted) else None


lanes = _Vector("lanes", types.float64, _DOUBLE)
lane_ints = _Vector("lane_ints", types.int64, _WORD)
mask = _Vector("mask", types.boolean, _BIT)


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: _Vector) -> None:
        super().__init__(manager, kind, ir.VectorType(kind.element, LANES))


class LanesAt(types.Type):
    """A pointer to a number of each filter, and behind them the next ones; ``kept``: as they are in memory.

    ``out``: they are written once, and not read by the kernel.
    """

    def __init__(self, dtype: types.Type, *, out: bool = False) -> None:
        self.kept, self.out = dtype, out
        self.held = lanes if dtype is types.float64 else lane_ints
        super().__init__(name=f"LanesAt({dtype}, {out})")


@register_model(LanesAt)
class _LanesAtModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: LanesAt) -> None:
        element = manager.lookup(kind.kept).get_data_type() if kind.kept is not types.uint8 else _BYTE
        super().__init__(manager, kind, element.as_pointer())


# -- memory


def _place(builder: Any, pointer: Any, index: Any) -> Any:
    """A pointer to the lanes of number ``index``."""
    first = builder.gep(pointer, [builder.mul(index, index.type(LANES))])
    return builder.bitcast(first, ir.VectorType(first.type.pointee, LANES).as_pointer())


def _get(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
    kind = signature.args[0]
    value = builder.load(_place(builder, *arguments), align=kind.kept.bitwidth // 8)
    return value if kind.held is lanes or kind.kept.bitwidth == 64 else builder.zext(value, _INTS)


def _set(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    pointer, index, value = arguments
    kind = signature.args[0]
    if kind.kept.bitwidth < 64:
        value = builder.trunc(value, ir.VectorType(_BYTE, LANES))
    store(builder, value, _place(builder, pointer, index), kind)
    return context.get_dummy_value()


def store(builder: Any, value: Any, place: Any, kind: LanesAt) -> None:
    """Put vectors of lanes there; what is out goes past the caches, which would read its lines before.

    It then has to begin with a line (``memory.aligned``), and so has each of its vectors.
    """
    if kind.out and kind.kept.bitwidth == 64:
        done = builder.store(value, place, align=LINE)
        done.set_metadata("nontemporal", builder.module.add_metadata([ir.IntType(32)(1)]))
    else:
        builder.store(value, place, align=kind.kept.bitwidth // 8)


@infer_global(operator.getitem)
class _GetTyping(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:  # noqa: ARG002  numba's protocol
        if isinstance(args[0], LanesAt):
            return signature(args[0].held, args[0], types.intp)
        return None


@infer_global(operator.setitem)
class _SetTyping(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:  # noqa: ARG002  numba's protocol
        if isinstance(args[0], LanesAt):
            return signature(types.none, args[0], types.intp, args[0].held)
        return None


lower_builtin(operator.getitem, LanesAt, types.Integer)(_get)
lower_builtin(operator.setitem, LanesAt, types.Integer, _Vector)(_set)


# -- from one to eight


def _spread(builder: Any, value: Any) -> Any:
    """The value in every lane."""
    vector = ir.VectorType(value.type, LANES)
    one = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), zeros)


def _widen(context: Any, builder: Any, source: Any, target: Any, value: Any) -> Any:
    return _spread(builder, context.cast(builder, value, source, target.single))


for _source in (types.Number, types.Boolean, types.IntegerLiteral, types.BooleanLiteral):
    lower_cast(_source, _Vector)(_widen)


# -- what is done lane by lane


def _each(kinds: tuple[_Vector, ...], result: Any, functions: tuple[Any, ...], emit: Callable[..., Any]) -> None:
    """Functions of these many vectors of a kind, or of a vector and a number; ``emit(context, builder, *values)``."""
    count = len(kinds)

    class Typing(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:  # noqa: ARG002  numba's protocol
            if len(args) != count or not any(arg is kind for arg, kind in zip(args, kinds, strict=True)):
                return None
            fits = all(
                arg is kind or isinstance(arg, (types.Number, types.Boolean))
                for arg, kind in zip(args, kinds, strict=True)
            )
            return signature(result, *kinds) if fits else None

    def lower(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        return emit(context, builder, *arguments)

    for function in functions:
        infer_global(function)(Typing)
        lower_builtin(function, *kinds)(lower)


def _instruction(name: str) -> Callable[..., Any]:
    return lambda _context, builder, *values: getattr(builder, name)(*values)


def _compare(name: str, sign: str) -> Callable[..., Any]:
    return lambda _context, builder, p, q: getattr(builder, name)(sign, p, q)


def _choose(sign: str) -> Callable[..., Any]:
    """The second number where it is ahead of the first, as Python has it."""
    return lambda _context, builder, p, q: builder.select(builder.fcmp_ordered(sign, q, p), q, p)


def _vector_function(name: str) -> Callable[..., Any]:
    def emit(_context: Any, builder: Any, value: Any) -> Any:
        kind = ir.FunctionType(_FLOATS, [_FLOATS])
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f64"), [value])

    return emit


def _one_by_one(function: Any, *shared: Any) -> Callable[..., Any]:
    """As numba does it for one number; the last arguments are ``shared`` by all, of these types."""

    def emit(context: Any, builder: Any, *values: Any) -> Any:
        own = len(values) - len(shared)
        kinds = (*[types.float64] * own, *shared)
        named = context.typing_context.resolve_value_type(function)
        one = context.get_function(function, context.typing_context.resolve_function_type(named, kinds, {}))
        result = ir.Constant(_FLOATS, ir.Undefined)
        for lane in range(LANES):
            at = ir.Constant(ir.IntType(32), lane)
            found = one(builder, [*(builder.extract_element(value, at) for value in values[:own]), *values[own:]])
            result = builder.insert_element(result, found, at)
        return result

    return emit


def _is_nan(_context: Any, builder: Any, value: Any) -> Any:
    return builder.fcmp_unordered("uno", value, value)


def _size(sign: str) -> Callable[..., Any]:
    """The absolute value against infinity."""

    def emit(context: Any, builder: Any, value: Any) -> Any:
        size = _vector_function("fabs")(context, builder, value)
        return builder.fcmp_ordered(sign, size, ir.Constant(_FLOATS, [math.inf] * LANES))

    return emit


_two, _one = (lanes, lanes), (lanes,)
for _name, _functions in {
    "fadd": (operator.add, operator.iadd),
    "fsub": (operator.sub, operator.isub),
    "fmul": (operator.mul, operator.imul),
    "fdiv": (operator.truediv, operator.itruediv),
}.items():
    _each(_two, lanes, _functions, _instruction(_name))
_ORDERED = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "==": operator.eq}
for _sign, _function in _ORDERED.items():
    _each(_two, mask, (_function,), _compare("fcmp_ordered", _sign))
_each(_two, mask, (operator.ne,), _compare("fcmp_unordered", "!="))
_each(_two, lanes, (operator.mod, operator.imod), _one_by_one(operator.mod))
_each(_two, lanes, (math.copysign,), _one_by_one(math.copysign))
_each(_two, lanes, (max,), _choose(">"))
_each(_two, lanes, (min,), _choose("<"))
_each(_one, lanes, (operator.neg,), _instruction("fneg"))
_each(_one, lanes, (math.sqrt,), _vector_function("sqrt"))
_each(_one, lanes, (math.floor,), _vector_function("floor"))
_each(_one, lanes, (abs,), _vector_function("fabs"))
_each(_one, mask, (math.isnan,), _is_nan)
_each(_one, mask, (math.isinf,), _size("=="))
_each(_one, mask, (math.isfinite,), _size("<"))
_each(_one, lane_ints, (int,), lambda _context, builder, value: builder.fptosi(value, _INTS))

_pair = (lane_ints, lane_ints)
_each(_pair, lane_ints, (operator.add, operator.iadd), _instruction("add"))
_each(_pair, lane_ints, (operator.sub, operator.isub), _instruction("sub"))
_each(_pair, lane_ints, (operator.and_, operator.iand), _instruction("and_"))
_each(_pair, mask, (operator.eq,), _compare("icmp_signed", "=="))
_each(_pair, mask, (operator.ne,), _compare("icmp_signed", "!="))

_each((mask, mask), mask, (operator.and_, operator.iand), _instruction("and_"))
_each((mask, mask), mask, (operator.or_, operator.ior), _instruction("or_"))
_each((mask,), mask, (operator.not_,), _instruction("not_"))


@infer_global(operator.pow)
class _PowTyping(AbstractTemplate):
    prefer_literal = True

    def generic(self, args: Any, kws: Any) -> Any:  # noqa: ARG002  numba's protocol
        fits = args[0] is lanes and isinstance(args[1], types.Number)
        shared = args[1] if isinstance(args[1], types.Integer) else types.float64
        return signature(lanes, lanes, shared) if fits else None


@lower_builtin(operator.pow, lanes, types.Number)
def _power(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """A power that is the same for all; of two as numba does it where it is written so."""
    exponent = signature.args[1]
    if isinstance(exponent, types.IntegerLiteral) and exponent.literal_value == 2:
        return builder.fmul(arguments[0], arguments[0])
    kind = types.int64 if isinstance(exponent, types.Integer) else types.float64
    power = context.cast(builder, arguments[1], exponent, kind)
    return _one_by_one(operator.pow, kind)(context, builder, arguments[0], power)


# -- decisions


def _alike(builder: Any, bits: Any) -> Any:
    """Whether the mask holds in all lanes; counts where it holds in some only."""
    every = _every(builder, bits)
    none = builder.icmp_unsigned("==", builder.bitcast(bits, _BYTE), _BYTE(0))
    with builder.if_then(builder.not_(builder.or_(every, none)), likely=False):
        builder.atomic_rmw("add", _counter(builder), _WORD(1), "monotonic")
    return every


def _every(builder: Any, bits: Any) -> Any:
    """Whether the mask holds in all lanes."""
    return builder.icmp_unsigned("==", builder.bitcast(bits, _BYTE), _BYTE((1 << LANES) - 1))


def _counter(builder: Any) -> Any:
    """How often lanes have disagreed, of all threads together."""
    found = builder.module.globals.get(_COUNTER)
    if found is None:
        found = ir.GlobalVariable(builder.module, _WORD, _COUNTER)
        found.linkage, found.initializer = "linkonce_odr", _WORD(0)
    return found


def _uniform(_context: Any, builder: Any, value: Any) -> Any:
    """The number that all lanes have."""
    first = builder.extract_element(value, ir.Constant(ir.IntType(32), 0))
    _alike(builder, builder.icmp_signed("==", value, _spread(builder, first)))
    return first


_each((mask,), types.boolean, (bool,), lambda _context, builder, value: _alike(builder, value))
_each((lane_ints,), types.int64, (int,), _uniform)


def _everywhere(typing_context: Any, condition: Any) -> Any:  # noqa: ARG001  numba reads this signature
    """Whether the condition holds in all lanes."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        if condition is mask:
            return _every(builder, arguments[0])
        return arguments[0]

    return types.boolean(condition), emit


def _where(typing_context: Any, condition: Any, then: Any, otherwise: Any) -> Any:  # noqa: ARG001  numba reads this signature
    """``then`` where the condition holds, else ``otherwise``; both are known."""
    wide = lanes if lanes in (then, otherwise) or condition is mask else types.float64

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        return builder.select(*arguments)

    return wide(condition, wide, wide), emit


def _together(typing_context: Any, p: Any, q: Any, r: Any) -> Any:  # noqa: ARG001  numba reads this signature
    """Three numbers as the first lanes of one vector; the rest is 0."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        vector = ir.Constant(_FLOATS, [0.0] * LANES)
        for lane, number in enumerate(arguments):
            vector = builder.insert_element(vector, number, ir.Constant(ir.IntType(32), lane))
        return vector

    return lanes(types.float64, types.float64, types.float64), emit


def _lane_of(typing_context: Any, vector: Any, lane: Any) -> Any:  # noqa: ARG001  numba reads this signature
    """The number in a lane."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        return builder.extract_element(arguments[0], ir.Constant(ir.IntType(32), lane.literal_value))

    return (types.float64(vector, lane), emit) if isinstance(lane, types.IntegerLiteral) else None


def _disagreements(typing_context: Any) -> Any:  # noqa: ARG001  numba reads this signature
    """How often lanes have disagreed, in all threads."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        return builder.load_atomic(_counter(builder), "monotonic", 8)

    return types.int64(), emit


def _tally(typing_context: Any, counts: Any, at: Any, which: Any, by: Any) -> Any:  # noqa: ARG001  numba reads this signature
    """counts[at + which] += by, where ``which`` is each filter's own."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        pointer, at, which, by = arguments
        if not isinstance(counts, LanesAt):
            spot = builder.gep(pointer, [builder.add(at, which)])
            builder.store(builder.add(builder.load(spot), by), spot)
            return context.get_dummy_value()
        for lane in range(LANES):
            own = builder.extract_element(which, ir.Constant(ir.IntType(32), lane))
            index = builder.add(builder.mul(builder.add(at, own), _WORD(LANES)), _WORD(lane))
            spot = builder.gep(pointer, [index])
            builder.store(builder.add(builder.load(spot), by), spot)
        return context.get_dummy_value()

    index = lane_ints if isinstance(counts, LanesAt) else types.intp
    return types.void(counts, types.intp, index, types.int64), emit


def _take_lane(typing_context: Any, to: Any, source: Any, at: Any, count: Any, lane: Any) -> Any:  # noqa: ARG001  numba reads this signature
    """to[at : at + count] = that lane of source[at : at + count]."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        to, source, at, count, lane = arguments
        with cgutils.for_range(builder, count) as loop:
            index = builder.add(at, loop.index)
            value = builder.load(builder.gep(source, [builder.add(builder.mul(index, index.type(LANES)), lane)]))
            builder.store(value, builder.gep(to, [index]))
        return context.get_dummy_value()

    return types.void(to, source, types.intp, types.intp, types.intp), emit


def _give_lane(typing_context: Any, to: Any, source: Any, at: Any, count: Any, lane: Any) -> Any:  # noqa: ARG001  numba reads this signature
    """That lane of to[at : at + count] = source[at : at + count]."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's protocol
        to, source, at, count, lane = arguments
        with cgutils.for_range(builder, count) as loop:
            index = builder.add(at, loop.index)
            value = builder.load(builder.gep(source, [index]))
            builder.store(value, builder.gep(to, [builder.add(builder.mul(index, index.type(LANES)), lane)]))
        return context.get_dummy_value()

    return types.void(to, source, types.intp, types.intp, types.intp), emit


class _Where(Protocol):
    def __call__(self, condition: bool, then: float, otherwise: float, /) -> float: ...


class _Tally(Protocol):
    def __call__(self, counts: Any, at: int, which: int, by: int, /) -> None: ...


class _Move(Protocol):
    def __call__(self, to: Any, source: Any, at: int, count: int, lane: int, /) -> None: ...


everywhere = cast(Callable[[bool], bool], intrinsic(_everywhere))
where = cast(_Where, intrinsic(_where))
together = cast(Callable[[float, float, float], float], intrinsic(_together))
lane_of = cast(Callable[[float, int], float], intrinsic(prefer_literal=True)(_lane_of))
disagreements = cast(Callable[[], int], intrinsic(_disagreements))
tally = cast(_Tally, intrinsic(_tally))
take_lane = cast(_Move, intrinsic(_take_lane))
give_lane = cast(_Move, intrinsic(_give_lane))
