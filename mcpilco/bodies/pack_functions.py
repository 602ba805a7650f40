"""Elementary functions of packs, by the formulas of the usual libraries of numbers.

Reference: Ng, exp, log and the kernels of sine and cosine, in Sun Microsystems' fdlibm (1993).
"""

from __future__ import annotations

import math
import operator
from typing import Any

from numba import types
from numba.extending import overload

from mcpilco.bodies.packs import BITS, NUMBERS, PACK, Pack, constant, lowered, where

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


def _two_to_the(k: Any) -> Any:
    """2^k of whole numbers from -1022 to 1023."""
    raise NotImplementedError("It is for compiled callers.")


def _power(_context, builder, _signature, args):
    bits = builder.bitcast(builder.fadd(args[0], constant(_SHIFT)), BITS)
    bits = builder.shl(bits, constant(52))
    return builder.bitcast(builder.add(bits, builder.bitcast(constant(1.0), BITS)), NUMBERS)


lowered(_two_to_the, lambda k: k, _power, (Pack,))


def in_quadrant(sin: Any, cos: Any, k: Any) -> tuple[Any, Any]:
    """Sine and cosine of an angle that is k quarters of a turn further."""
    raise NotImplementedError("It is for compiled callers.")


def _turned(context, builder, signature, args):
    bits = builder.bitcast(builder.fadd(args[2], constant(_SHIFT)), BITS)
    odd = builder.icmp_signed("<", builder.shl(bits, constant(63)), constant(0))
    sin, cos = builder.select(odd, *args[1::-1]), builder.select(odd, *args[:2])
    turned = []
    for x, further in ((sin, 0), (cos, 1)):
        half = builder.and_(builder.add(bits, constant(further)), constant(2))
        sign = builder.shl(half, constant(62))
        turned.append(builder.bitcast(builder.xor(builder.bitcast(x, BITS), sign), NUMBERS))
    return context.make_tuple(builder, signature.return_type, turned)


lowered(
    in_quadrant,
    lambda _sin, _cos, k: types.UniTuple(PACK, 2) if isinstance(k, Pack) else None,
    _turned,
    (Pack, Pack, Pack),
)


@overload(in_quadrant)
def _turned_number(sin, cos, k):
    if isinstance(k, Pack):
        return None

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
        x = where(x < -708.0, -708.0, x)
        x = where(x > 709.0, 709.0, x)
        k = math.floor(x * (1.0 / math.log(2.0)) + 0.5)
        high, low = x - k * _LOG2[0], k * _LOG2[1]
        r = high - low
        z = r * r
        c = r - z * (_EXP[0] + z * (_EXP[1] + z * (_EXP[2] + z * (_EXP[3] + z * _EXP[4]))))
        return (1.0 - ((low - r * c / (2.0 - c)) - high)) * _two_to_the(k)

    return exp


def _mantissa(x: Any) -> tuple[Any, Any]:
    """x = m 2^k of positive numbers: m from sqrt(1/2) to sqrt(2), and k."""
    raise NotImplementedError("It is for compiled callers.")


def _parts(context, builder, signature, args):
    bits = builder.add(builder.bitcast(args[0], BITS), constant(_HALF_ROOT))
    k = builder.lshr(bits, constant(52))
    mantissa = builder.and_(bits, constant((1 << 52) - 1))
    mantissa = builder.sub(builder.add(mantissa, constant(1023 << 52)), constant(_HALF_ROOT))
    k = builder.bitcast(builder.or_(k, builder.bitcast(constant(2.0**52), BITS)), NUMBERS)
    k = builder.fsub(k, constant(2.0**52 + 1023.0))
    return context.make_tuple(
        builder, signature.return_type, [builder.bitcast(mantissa, NUMBERS), k]
    )


lowered(_mantissa, lambda _x: types.UniTuple(PACK, 2), _parts, (Pack,))


@overload(math.log)
def _log(x):
    if not isinstance(x, Pack):
        return None

    def log(x):
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
