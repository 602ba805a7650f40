"""Several numbers as one, for compiled callers: each operation is done with all of them at once.

A `Pack` holds a number of each of `LANES` motions, in registers for vectors. Formulas for a number
take packs as well, as long as they decide nothing by an `if`: `where` picks lane by lane.
Arithmetic that waits for its own results, as a motion's does from step to step, takes hardly longer
for a pack than for one number.

`pack_functions` has exp, log and what sine and cosine need, `pack_arrays` arrays of packs.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, lower_cast, models, register_model

LANES = 8
"""numbers in a pack: two registers of today's processors, whose operations overlap"""
_LONG = ir.IntType(64)
NUMBERS, BITS = ir.VectorType(ir.DoubleType(), LANES), ir.VectorType(_LONG, LANES)
"""a pack in registers: its numbers, or their bits"""


class Pack(types.Type):
    """numba's type of a pack."""

    def __init__(self) -> None:
        super().__init__("Pack")

    def can_convert_from(self, typingctx, other):
        numbers = isinstance(other, types.Float | types.Integer)
        return Conversion.unsafe if numbers else None  # a function of numbers is preferred

    def unify(self, typingctx, other):
        return self if isinstance(other, types.Float | types.Integer) else None


class Choice(types.Type):
    """numba's type of a truth value of each lane."""

    def __init__(self) -> None:
        super().__init__("Choice")


PACK, CHOICE = Pack(), Choice()


@register_model(Pack)
class _PackModel(models.PrimitiveModel):
    def __init__(self, manager, kind) -> None:
        super().__init__(manager, kind, NUMBERS)


@register_model(Choice)
class _ChoiceModel(models.PrimitiveModel):
    def __init__(self, manager, kind) -> None:
        super().__init__(manager, kind, BITS)


def _spread(builder, x):
    """A vector of a number, or of an integer, in each lane."""
    kind = ir.VectorType(x.type, LANES)
    first = builder.insert_element(ir.Constant(kind, ir.Undefined), x, _index(0))
    return builder.shuffle_vector(
        first,
        ir.Constant(kind, ir.Undefined),
        ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES),
    )


def _index(k: int):
    return ir.Constant(ir.IntType(32), k)


def constant(x: float | int):
    """The same number in each lane."""
    kind = NUMBERS if isinstance(x, float) else BITS
    return ir.Constant(kind, [x] * LANES)


def as_vector(context, builder, kind, x):
    """A pack, or a number in each lane."""
    if isinstance(kind, Pack):
        return x
    return _spread(builder, context.cast(builder, x, kind, types.float64))


@lower_cast(types.Float, Pack)
@lower_cast(types.Integer, Pack)
def _cast(context, builder, given, wanted, x):
    return as_vector(context, builder, given, x)


def _call(name: str) -> Callable[..., Any]:
    """Calls LLVM's function of this name, of vectors."""

    def emit(builder, *args):
        kind = ir.FunctionType(NUMBERS, [NUMBERS] * len(args))
        whole = f"llvm.{name}.v{LANES}f64"
        function = builder.module.globals.get(whole) or ir.Function(builder.module, kind, whole)
        return builder.call(function, args)

    return emit


def lowered(
    function: Callable[..., Any],
    typed: Callable[..., types.Type | None],
    emit: Callable[..., Any],
    *kinds: tuple[Any, ...],
) -> None:
    """Lets numba compile calls of a function to instructions, with no function around them.

    Args:
        function: that is called.
        typed: the type of its result, of the types of its arguments; None where these do not fit.
        emit: the instructions, of context, builder, signature and arguments.
        kinds: classes of types of the arguments.
    """

    class Typed(AbstractTemplate):
        key = function

        def generic(self, args, kws):
            result = typed(*args) if len(args) == len(kinds[0]) and not kws else None
            return None if result is None else signature(result, *args)

    infer_global(function, types.Function(Typed))
    for kind in kinds:
        lower_builtin(function, *kind)(emit)


def _lanewise(
    function: Callable[..., Any], emit: Callable[..., Any], *, result: Any = None
) -> None:
    """Lets a function of one or two numbers take packs, and one of the two stay a number."""
    two = (Pack, Pack), (Pack, types.Number), (types.Number, Pack)

    def typed(*arguments):
        fit = all(isinstance(each, Pack | types.Number) for each in arguments)
        some = any(isinstance(each, Pack) for each in arguments)
        return (result or PACK) if fit and some else None

    def generate(context, builder, signature, args):
        pairs = zip(signature.args, args, strict=True)
        return emit(builder, *(as_vector(context, builder, kind, x) for kind, x in pairs))

    lowered(function, typed, generate, *(((Pack,),) if function in _OF_ONE else two))


def _flags(builder, choice):
    """A bit of each lane; a register holds all bits of a lane, of which the sign counts."""
    return builder.icmp_signed("<", choice, constant(0))


def _compared(sign: str) -> Callable[..., Any]:
    def emit(builder, a, b):
        ordered = builder.fcmp_unordered if sign == "!=" else builder.fcmp_ordered
        return builder.sext(ordered(sign, a, b), BITS)

    return emit


_OF_ONE: dict[Any, Callable[..., Any]] = {
    operator.neg: lambda builder, a: builder.fneg(a),
    abs: _call("fabs"),
    math.floor: _call("floor"),
    math.sqrt: _call("sqrt"),
}
_OPERATORS: dict[str, tuple[Any, ...]] = {
    "fadd": (operator.add, operator.iadd),
    "fsub": (operator.sub, operator.isub),
    "fmul": (operator.mul, operator.imul),
    "fdiv": (operator.truediv, operator.itruediv),
}
_ORDERS: dict[str, Any] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
for _function, _emit in _OF_ONE.items():
    _lanewise(_function, _emit)
for _name, _functions in _OPERATORS.items():
    for _function in _functions:
        _lanewise(_function, lambda builder, a, b, name=_name: getattr(builder, name)(a, b))
for _sign, _function in _ORDERS.items():
    _lanewise(_function, _compared(_sign), result=CHOICE)
_EXTREMES: dict[Any, str] = {min: "<", max: ">"}
for _function, _sign in _EXTREMES.items():  # the second where one is no number
    _lanewise(_function, lambda b, x, y, s=_sign: b.select(b.fcmp_ordered(s, x, y), x, y))
_lanewise(math.copysign, _call("copysign"))
for _function, _name in ((operator.and_, "and_"), (operator.or_, "or_")):
    lowered(
        _function,
        lambda a, b: CHOICE if isinstance(a, Choice) and isinstance(b, Choice) else None,
        lambda _c, builder, _s, args, name=_name: getattr(builder, name)(*args),
        (Choice, Choice),
    )


def where(choice: Any, a: Any, b: Any) -> Any:
    """A number, or lane by lane: `a` where a condition holds, else `b`. Both are computed."""
    return a if choice else b


def _pick(context, builder, signature, args):
    kinds, result = signature.args[1:], signature.return_type
    pairs = zip(kinds, args[1:], strict=True)
    a, b = (context.cast(builder, x, kind, result) for kind, x in pairs)
    flag = _flags(builder, args[0]) if isinstance(signature.args[0], Choice) else args[0]
    return builder.select(flag, a, b)


def _picked(choice, a, b):
    packs = isinstance(choice, Choice) or isinstance(a, Pack) or isinstance(b, Pack)
    return PACK if packs else types.float64


lowered(where, _picked, _pick, *((c, types.Any, types.Any) for c in (Choice, types.Boolean)))


def anywhere(choice: Any) -> bool:
    """Whether a condition holds in any lane."""
    return bool(choice)


def everywhere(choice: Any) -> bool:
    """Whether a condition holds in all lanes."""
    return bool(choice)


def count(choice: Any) -> int:
    """In how many lanes a condition holds."""
    return int(choice)


def _of_bits(function: Callable[..., Any], result: types.Type, emit: Callable[..., Any]) -> None:
    """Lets a function of a choice take what its lanes say, one a bit; of a truth value, one."""

    def generate(_context, builder, signature, args):
        bits = args[0]
        if isinstance(signature.args[0], Choice):
            bits = builder.bitcast(_flags(builder, bits), ir.IntType(LANES))
        return emit(builder, bits)

    fitting = Choice, types.Boolean
    lowered(
        function,
        lambda choice: result if isinstance(choice, fitting) else None,
        generate,
        *((kind,) for kind in fitting),
    )


_of_bits(anywhere, types.boolean, lambda b, x: b.icmp_unsigned("!=", x, ir.Constant(x.type, 0)))
_of_bits(everywhere, types.boolean, lambda b, x: b.icmp_unsigned("==", x, ir.Constant(x.type, -1)))
_of_bits(count, types.int64, lambda b, x: b.zext(b.ctpop(x), _LONG))


def lanes_of(x: Any) -> int:
    """How many numbers x holds: 1, or `LANES` if it is a pack."""
    return 1


def lane(x: Any, k: int) -> float:
    """The number of lane k."""
    return x


def with_lane(x: Any, k: int, number: float) -> Any:
    """The same with another number in lane k."""
    return number


def _place(context, builder, kind, k):
    return builder.trunc(context.cast(builder, k, kind, types.int64), ir.IntType(32))


def _extract(context, builder, signature, args):
    if not isinstance(signature.args[0], Pack):
        return context.cast(builder, args[0], signature.args[0], types.float64)
    return builder.extract_element(args[0], _place(context, builder, signature.args[1], args[1]))


def _insert(context, builder, signature, args):
    number = context.cast(builder, args[2], signature.args[2], types.float64)
    if not isinstance(signature.args[0], Pack):
        return number
    place = _place(context, builder, signature.args[1], args[1])
    return builder.insert_element(args[0], number, place)


_VALUES = Pack, types.Number
lowered(
    lanes_of,
    lambda _x: types.int64,
    lambda _c, _b, signature, _a: ir.Constant(
        _LONG, LANES if isinstance(signature.args[0], Pack) else 1
    ),
    *((kind,) for kind in _VALUES),
)
lowered(lane, lambda _x, _k: types.float64, _extract, *((kind, types.Integer) for kind in _VALUES))
lowered(
    with_lane,
    lambda x, _k, _number: x if isinstance(x, Pack) else types.float64,
    _insert,
    *((kind, types.Integer, types.Number) for kind in _VALUES),
)
