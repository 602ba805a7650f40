"""Several numbers as one, for compiled callers: each operation is done with all of them at once.

A `Pack` holds a number of each of `LANES` motions. Formulas that are written for a number take packs
as well, as long as they decide nothing by an `if`: `where` picks lane by lane. Arithmetic that waits
for its own results, as a motion's does from step to step, takes no longer for a pack than for one
number. `as_packs` makes packs of arrays, which compiled code indexes like arrays of numbers.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils, imputils
from numba.core.typeconv import Conversion
from numba.extending import (
    intrinsic,
    lower_cast,
    make_attribute_wrapper,
    models,
    overload,
    register_model,
)

LANES = 8
"""numbers in a pack: two registers of today's processors, whose operations overlap"""
_DOUBLE, _LONG = ir.DoubleType(), ir.IntType(64)
_NUMBERS, _BITS = ir.VectorType(_DOUBLE, LANES), ir.VectorType(_LONG, LANES)
_SHIFT = 6755399441055744.0
"""1.5 2^52: added to a whole number it leaves this in the last bits"""
_LOG2 = 6.93147180369123816490e-01, 1.90821492927058770002e-10
"""ln 2 in two parts, of which a thousand times the first is exact"""
_EXP = (
    *(1.66666666666666019037e-01, -2.77777777770155933842e-03, 6.61375632143793436117e-05),
    *(-1.65339022054652515390e-06, 4.13813679705723846039e-08),
)
"""coefficients of r^2, r^4, ... in r (exp(r) + 1) / (exp(r) - 1) - 2"""
_LOG = (
    *(6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01),
    *(2.222219843214978396e-01, 1.818357216161805012e-01, 1.531383769920937332e-01),
    1.479819860511658591e-01,
)
"""coefficients of s^2, s^4, ... in log((1 + s) / (1 - s)) / s - 2"""
_HALF_ROOT = (1023 << 52) - 0x3FE6A09E667F3BCD
"""from the bits of sqrt(1/2) to those of 1"""


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


class PacksType(types.Type):
    """numba's type of an array of packs."""

    def __init__(self, data: types.Array) -> None:
        super().__init__(f"Packs({data})")
        self.data = data


PACK, CHOICE = Pack(), Choice()


@register_model(Pack)
class _PackModel(models.PrimitiveModel):
    def __init__(self, manager, kind) -> None:
        super().__init__(manager, kind, _NUMBERS)


@register_model(Choice)
class _ChoiceModel(models.PrimitiveModel):
    def __init__(self, manager, kind) -> None:
        super().__init__(manager, kind, _BITS)


@register_model(PacksType)
class _PacksModel(models.StructModel):
    def __init__(self, manager, kind) -> None:
        super().__init__(manager, kind, [("data", kind.data)])


make_attribute_wrapper(PacksType, "data", "data")


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


def _constant(x: float | int):
    """The same number in each lane."""
    kind = _NUMBERS if isinstance(x, float) else _BITS
    return ir.Constant(kind, [x] * LANES)


def _as_vector(context, builder, kind, x):
    """A pack, or a number in each lane."""
    if isinstance(kind, Pack):
        return x
    return _spread(builder, context.cast(builder, x, kind, types.float64))


@lower_cast(types.Float, Pack)
@lower_cast(types.Integer, Pack)
def _cast(context, builder, given, wanted, x):
    return _as_vector(context, builder, given, x)


def _call(name: str) -> Callable[..., Any]:
    """Calls LLVM's function of this name, of vectors."""

    def emit(builder, *args):
        kind = ir.FunctionType(_NUMBERS, [_NUMBERS] * len(args))
        whole = f"llvm.{name}.v{LANES}f64"
        function = builder.module.globals.get(whole) or ir.Function(builder.module, kind, whole)
        return builder.call(function, args)

    return emit


def _lanewise(result: types.Type, emit: Callable[..., Any], count: int) -> Callable[..., Any]:
    """A function of `count` packs or numbers, compiled to an instruction."""

    def generate(context, builder, signature, args):
        pairs = zip(signature.args, args, strict=True)
        return emit(builder, *(_as_vector(context, builder, kind, x) for kind, x in pairs))

    if count == 1:
        return intrinsic(lambda _context, a: (result(a), generate))
    if count == 2:
        return intrinsic(lambda _context, a, b: (result(a, b), generate))
    return intrinsic(lambda _context, a, b, c: (result(a, b, c), generate))


def _some_pack(*kinds: Any) -> bool:
    numbers = all(isinstance(kind, Pack | types.Number) for kind in kinds)
    return numbers and any(isinstance(kind, Pack) for kind in kinds)


def _of_one(function: Callable[..., Any], emit: Callable[..., Any]) -> None:
    low = _lanewise(PACK, emit, 1)

    @overload(function)
    def typed(a):
        return (lambda a: low(a)) if isinstance(a, Pack) else None


def _of_two(function: Callable[..., Any], emit: Callable[..., Any], result=PACK) -> None:
    low = _lanewise(result, emit, 2)

    @overload(function)
    def typed(a, b):
        return (lambda a, b: low(a, b)) if _some_pack(a, b) else None


def _flags(builder, choice):
    """A bit of each lane; a register holds all bits of a lane, of which the sign counts."""
    return builder.icmp_signed("<", choice, _constant(0))


def _compared(sign: str) -> Callable[..., Any]:
    def emit(builder, a, b):
        ordered = builder.fcmp_unordered if sign == "!=" else builder.fcmp_ordered
        return builder.sext(ordered(sign, a, b), _BITS)

    return emit


for _operators, _name in {
    (operator.add, operator.iadd): "fadd",
    (operator.sub, operator.isub): "fsub",
    (operator.mul, operator.imul): "fmul",
    (operator.truediv, operator.itruediv): "fdiv",
}.items():
    for _operator in _operators:
        _of_two(_operator, lambda builder, a, b, name=_name: getattr(builder, name)(a, b))
_of_two(math.copysign, _call("copysign"))
for _sign, _comparison in {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}.items():
    _of_two(_comparison, _compared(_sign), CHOICE)
_of_one(operator.neg, lambda builder, a: builder.fneg(a))
_of_one(abs, _call("fabs"))
_of_one(math.floor, _call("floor"))
_of_one(math.sqrt, _call("sqrt"))
for _extreme, _sign in ((min, "<"), (max, ">")):  # the second where one is no number
    _of_two(_extreme, lambda b, x, y, s=_sign: b.select(b.fcmp_ordered(s, x, y), x, y))


def _of_choices(function: Callable[..., Any], name: str) -> None:
    def generate(_c, builder, _signature, args):
        return getattr(builder, name)(*args)

    low = intrinsic(lambda _context, a, b: (CHOICE(a, b), generate))

    @overload(function)
    def typed(a, b):
        choices = isinstance(a, Choice) and isinstance(b, Choice)
        return (lambda a, b: low(a, b)) if choices else None


_of_choices(operator.and_, "and_")
_of_choices(operator.or_, "or_")


@intrinsic
def _pick(_context, choice, a, b):
    def generate(context, builder, signature, args):
        pairs = zip(signature.args[1:], args[1:], strict=True)
        both = (_as_vector(context, builder, kind, x) for kind, x in pairs)
        return builder.select(_flags(builder, args[0]), *both)

    return PACK(choice, a, b), generate


def where(choice: Any, a: Any, b: Any) -> Any:
    """A number, or lane by lane: `a` where a condition holds, else `b`. Both are computed."""
    return a if choice else b


@overload(where)
def _where(choice, a, b):
    if isinstance(choice, Choice):
        return lambda choice, a, b: _pick(choice, a, b)
    return lambda choice, a, b: a if choice else b


def _counted(comparison: str, bits: int) -> Callable[..., Any]:
    """A function of a choice, compiled to a comparison of its lanes, one a bit."""

    def generate(_c, builder, _signature, args):
        kind = ir.IntType(LANES)
        flags = builder.bitcast(_flags(builder, args[0]), kind)
        return builder.icmp_unsigned(comparison, flags, ir.Constant(kind, bits))

    return intrinsic(lambda _context, choice: (types.boolean(choice), generate))


_any, _all = _counted("!=", 0), _counted("==", -1)


def anywhere(choice: Any) -> bool:
    """Whether a condition holds in any lane."""
    return bool(choice)


@overload(anywhere)
def _anywhere(choice):
    if isinstance(choice, Choice):
        return lambda choice: _any(choice)
    return lambda choice: choice


def everywhere(choice: Any) -> bool:
    """Whether a condition holds in all lanes."""
    return bool(choice)


@overload(everywhere)
def _everywhere(choice):
    if isinstance(choice, Choice):
        return lambda choice: _all(choice)
    return lambda choice: choice


@intrinsic
def _count(_context, choice):
    def generate(context, builder, _signature, args):
        bits = builder.bitcast(_flags(builder, args[0]), ir.IntType(LANES))
        return builder.zext(builder.ctpop(bits), _LONG)

    return types.int64(choice), generate


def count(choice: Any) -> int:
    """In how many lanes a condition holds."""
    return int(choice)


@overload(count)
def _counts(choice):
    if isinstance(choice, Choice):
        return lambda choice: _count(choice)
    return lambda choice: int(choice)


@intrinsic
def _extract(_context, x, k):
    def generate(_c, builder, _signature, args):
        return builder.extract_element(args[0], builder.trunc(args[1], ir.IntType(32)))

    return types.float64(x, types.intp), generate


@intrinsic
def _insert(_context, x, k, number):
    def generate(_c, builder, _signature, args):
        return builder.insert_element(args[0], args[2], builder.trunc(args[1], ir.IntType(32)))

    return PACK(x, types.intp, types.float64), generate


def lanes_of(x: Any) -> int:
    """How many numbers x holds: 1, or `LANES` if it is a pack."""
    return 1


@overload(lanes_of)
def _lanes_of(x):
    count = LANES if isinstance(x, Pack) else 1
    return lambda x: count


def lane(x: Any, k: int) -> float:
    """The number of lane k."""
    return x


@overload(lane)
def _lane(x, k):
    return (lambda x, k: _extract(x, k)) if isinstance(x, Pack) else (lambda x, k: x)


def with_lane(x: Any, k: int, number: float) -> Any:
    """The same with another number in lane k."""
    return number


@overload(with_lane)
def _with_lane(x, k, number):
    if isinstance(x, Pack):
        return lambda x, k, number: _insert(x, k, number)
    return lambda x, k, number: number


@intrinsic
def _two_to_the(_context, k):
    """2^k of whole numbers from -1022 to 1023."""

    def generate(_c, builder, _signature, args):
        bits = builder.bitcast(builder.fadd(args[0], _constant(_SHIFT)), _BITS)
        bits = builder.shl(bits, _constant(52))
        return builder.bitcast(builder.add(bits, builder.bitcast(_constant(1.0), _BITS)), _NUMBERS)

    return PACK(k), generate


@intrinsic
def _in_quadrant(_context, sin, cos, k):

    def generate(context, builder, signature, args):
        bits = builder.bitcast(builder.fadd(args[2], _constant(_SHIFT)), _BITS)
        odd = builder.icmp_signed("<", builder.shl(bits, _constant(63)), _constant(0))
        sin, cos = builder.select(odd, *args[1::-1]), builder.select(odd, *args[:2])
        turned = []
        for x, further in ((sin, 0), (cos, 1)):
            half = builder.and_(builder.add(bits, _constant(further)), _constant(2))
            sign = builder.shl(half, _constant(62))
            turned.append(builder.bitcast(builder.xor(builder.bitcast(x, _BITS), sign), _NUMBERS))
        return context.make_tuple(builder, signature.return_type, turned)

    return types.UniTuple(PACK, 2)(sin, cos, k), generate


def in_quadrant(sin: Any, cos: Any, k: Any) -> tuple[Any, Any]:
    """Sine and cosine of an angle that is k quarters of a turn further."""
    raise NotImplementedError("It is for compiled callers.")


@overload(in_quadrant)
def _turned(sin, cos, k):
    if isinstance(k, Pack):
        return lambda sin, cos, k: _in_quadrant(sin, cos, k)

    def turned(sin, cos, k):
        n = int(k)
        if n & 1:
            sin, cos = cos, sin
        return -sin if n & 2 else sin, -cos if (n + 1) & 2 else cos

    return turned


@overload(math.exp)
def _exp(x):
    if not isinstance(x, Pack):
        return None

    def exp(x):
        """Reference: Ng, exp, in Sun Microsystems' fdlibm (1993)."""
        x = where(x < -708.0, -708.0, x)
        x = where(x > 709.0, 709.0, x)
        k = math.floor(x * (1.0 / math.log(2.0)) + 0.5)
        high, low = x - k * _LOG2[0], k * _LOG2[1]
        r = high - low
        z = r * r
        c = r - z * (_EXP[0] + z * (_EXP[1] + z * (_EXP[2] + z * (_EXP[3] + z * _EXP[4]))))
        return (1.0 - ((low - r * c / (2.0 - c)) - high)) * _two_to_the(k)

    return exp


@intrinsic
def _mantissa(_context, x):
    """x = m 2^k of positive numbers: m from sqrt(1/2) to sqrt(2), and k."""

    def generate(context, builder, signature, args):
        bits = builder.add(builder.bitcast(args[0], _BITS), _constant(_HALF_ROOT))
        k = builder.lshr(bits, _constant(52))
        mantissa = builder.and_(bits, _constant((1 << 52) - 1))
        mantissa = builder.sub(builder.add(mantissa, _constant(1023 << 52)), _constant(_HALF_ROOT))
        k = builder.bitcast(builder.or_(k, builder.bitcast(_constant(2.0**52), _BITS)), _NUMBERS)
        k = builder.fsub(k, _constant(2.0**52 + 1023.0))
        parts = [builder.bitcast(mantissa, _NUMBERS), k]
        return context.make_tuple(builder, signature.return_type, parts)

    return types.UniTuple(PACK, 2)(x), generate


@overload(math.log)
def _log(x):
    if not isinstance(x, Pack):
        return None

    def log(x):
        """Of positive numbers that are not denormal.

        Reference: Ng, log, in Sun Microsystems' fdlibm (1993).
        """
        m, k = _mantissa(x)
        f = m - 1.0
        s = f / (2.0 + f)
        z = s * s
        R = _LOG[3] + z * (_LOG[4] + z * (_LOG[5] + z * _LOG[6]))
        R = z * (_LOG[0] + z * (_LOG[1] + z * (_LOG[2] + z * R)))
        half = 0.5 * f * f
        return k * _LOG2[0] - ((half - (s * (half + R) + k * _LOG2[1])) - f)

    return log


@overload(operator.pow)
def _pow(x, y):
    if isinstance(x, Pack) and isinstance(y, types.Float):
        return lambda x, y: math.exp(y * math.log(x))
    return None


@overload(len)
def _len(packs):
    return (lambda packs: packs.data.shape[0]) if isinstance(packs, PacksType) else None


def _wrap(context, builder, kind, array):
    packs = cgutils.create_struct_proxy(kind)(context, builder)
    packs.data = array
    return packs._getvalue()


@intrinsic
def _row(_context, data):
    kind = PacksType(data)

    def generate(context, builder, _signature, args):
        packs = _wrap(context, builder, kind, args[0])
        return imputils.impl_ret_borrowed(context, builder, kind, packs)

    return kind(data), generate


@intrinsic
def as_packs(_context, arrays):
    """A tuple of arrays as one of packs, whose lanes are last; what are no floats stays.

    Tuples in it are changed likewise.
    """

    def changed(kind):
        if isinstance(kind, types.BaseTuple):
            return types.BaseTuple.from_types([changed(each) for each in kind], _class_of(kind))
        floats = isinstance(kind, types.Array) and kind.dtype == types.float64
        return PacksType(kind) if floats else kind

    def emit(context, builder, before, after, value):
        if before == after:
            return value
        if isinstance(after, PacksType):
            return _wrap(context, builder, after, value)
        parts = cgutils.unpack_tuple(builder, value)
        each = zip(before, after, parts, strict=True)
        return context.make_tuple(builder, after, [emit(context, builder, *one) for one in each])

    def generate(context, builder, _signature, args):
        packs = emit(context, builder, arrays, result, args[0])
        return imputils.impl_ret_borrowed(context, builder, result, packs)

    result = changed(arrays)
    return result(arrays), generate


def _class_of(kind: types.BaseTuple) -> type | None:
    """Of a named tuple."""
    return getattr(kind, "instance_class", None)


def _pointer(context, builder, signature, args):
    """Of the numbers of a pack."""
    array = context.make_array(signature.args[0])(context, builder, args[0])
    indices = cgutils.unpack_tuple(builder, args[1])
    kinds = signature.args[1]
    indices = [
        context.cast(builder, x, kind, types.intp) for x, kind in zip(indices, kinds, strict=True)
    ]
    shape = cgutils.unpack_tuple(builder, array.shape)
    strides = cgutils.unpack_tuple(builder, array.strides)
    zero = context.get_constant(types.intp, 0)
    first = cgutils.get_item_pointer2(
        context, builder, array.data, shape, strides, "C", [*indices, zero]
    )
    return builder.bitcast(first, _NUMBERS.as_pointer())


@intrinsic
def _load(_context, data, index):
    def generate(context, builder, signature, args):
        return builder.load(_pointer(context, builder, signature, args), align=8)

    return PACK(data, index), generate


@intrinsic
def _store(_context, data, index, x):
    def generate(context, builder, signature, args):
        x = _as_vector(context, builder, signature.args[2], args[2])
        builder.store(x, _pointer(context, builder, signature, args), align=8)
        return context.get_dummy_value()

    return types.void(data, index, x), generate


def _indices(index: types.Type) -> int:
    return len(index) if isinstance(index, types.BaseTuple) else 1


@overload(operator.getitem)
def _getitem(packs, index):
    if not isinstance(packs, PacksType):
        return None
    if _indices(index) < packs.data.ndim - 1:
        return lambda packs, index: _row(packs.data[index])
    if isinstance(index, types.BaseTuple):
        return lambda packs, index: _load(packs.data, index)
    return lambda packs, index: _load(packs.data, (index,))


@overload(operator.setitem)
def _setitem(packs, index, value):
    if not isinstance(packs, PacksType) or _indices(index) != packs.data.ndim - 1:
        return None
    if isinstance(index, types.BaseTuple):
        return lambda packs, index, value: _store(packs.data, index, value)
    return lambda packs, index, value: _store(packs.data, (index,), value)
