"""Scalar arithmetic for the compiled loops: an exponential that vectorises, and the dropout hash.

The wheels of llvmlite carry no vector mathematics library, so `math.exp` in a numba loop is one
call a number; the polynomial below stays inside the loop, where the compiler turns it into vector
instructions.
"""

from __future__ import annotations

import math

from llvmlite import ir
from numba import njit, types, uint32
from numba.extending import intrinsic

OPTIONS = {"fastmath": {"reassoc", "contract", "nsz"}, "cache": True, "error_model": "numpy"}
"""Sums may be reordered; infinities and NaN keep their meaning: they tell a diverged particle."""
PLAIN = {**OPTIONS, "_nrt": False}
"""Without numba's runtime a function allocates nothing, and a slice costs no reference count."""

_LOG2_E = 1.0 / math.log(2.0)
_LN2_HIGH = float.fromhex("0x1.62e42feep-1")
_LN2_LOW = float.fromhex("0x1.a39ef35793c76p-33")
_SMALLEST = -200.0
_TAYLOR = tuple(1.0 / math.factorial(k) for k in range(14))


@intrinsic
def _round(typing_context, x):
    """Nearest integer, as a float."""

    def generate(context, builder, signature, args):
        function = builder.module.declare_intrinsic("llvm.rint", [args[0].type])
        return builder.call(function, args)

    return types.float64(types.float64), generate


@intrinsic
def _fma(typing_context, a, b, c):
    """a b + c with one rounding; also a fence that reordered sums do not cross."""

    def generate(context, builder, signature, args):
        return builder.fma(*args)

    return types.float64(types.float64, types.float64, types.float64), generate


@intrinsic
def _power_of_two(typing_context, n):
    """2^n for an integer n in the range of normal numbers, built from its bits."""

    def generate(context, builder, signature, args):
        small = builder.fptosi(args[0], ir.IntType(32))
        biased = builder.add(small, ir.Constant(ir.IntType(32), 1023))
        bits = builder.shl(builder.zext(biased, ir.IntType(64)), ir.Constant(ir.IntType(64), 52))
        return builder.bitcast(bits, ir.DoubleType())

    return types.float64(types.float64), generate


@njit(inline="always")
def exp(x):
    """e^x for x <= 0, relative error below 1e-15.

    x below -200 gives e^-200, so that no product becomes subnormal, which would be slow.

    x = n ln 2 + r with abs(r) <= ln 2 / 2, and a Taylor polynomial of degree 13 for e^r.
    """
    x = max(x, _SMALLEST)
    n = _round(x * _LOG2_E)
    r = _fma(n, -_LN2_LOW, _fma(n, -_LN2_HIGH, x))
    y = _TAYLOR[13]
    y = y * r + _TAYLOR[12]
    y = y * r + _TAYLOR[11]
    y = y * r + _TAYLOR[10]
    y = y * r + _TAYLOR[9]
    y = y * r + _TAYLOR[8]
    y = y * r + _TAYLOR[7]
    y = y * r + _TAYLOR[6]
    y = y * r + _TAYLOR[5]
    y = y * r + _TAYLOR[4]
    y = y * r + _TAYLOR[3]
    y = y * r + _TAYLOR[2]
    y = y * r + _TAYLOR[1]
    y = y * r + _TAYLOR[0]
    return y * _power_of_two(n)


@njit(inline="always")
def mix(x):
    """The hash of `mcpilco.dropout.mix`, for one 32-bit integer."""
    x = uint32(x)
    x = uint32(x ^ uint32(x >> uint32(16)))
    x = uint32(x * uint32(0x7FEB352D))
    x = uint32(x ^ uint32(x >> uint32(15)))
    x = uint32(x * uint32(0x846CA68B))
    return uint32(x ^ uint32(x >> uint32(16)))


@njit(**PLAIN)
def set_exponentials(exponents, scale):
    """Scale times e^exponent, in place; exponents are not positive but for rounding."""
    for j in range(exponents.size):
        exponents[j] = scale * exp(min(exponents[j], 0.0))
