"""Scalar arithmetic for the compiled loops: an exponential that vectorises, and the dropout hash.

The wheels of llvmlite carry no vector mathematics library, so `math.exp` in a numba loop is one
call a number; the instructions below stay inside the loop, where the compiler turns them into
vector instructions.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from llvmlite import ir
from numba import njit, types, uint32
from numba.extending import intrinsic

PLAIN = {
    # sums may be reordered; infinities and NaN keep their meaning: they tell a diverged particle
    "fastmath": {"reassoc", "contract", "nsz"},
    "error_model": "numpy",
    # without numba's runtime a function allocates nothing; a slice costs no reference count
    "_nrt": False,
    # to be called from compiled code only: an entrance for Python takes longer to compile than most
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}
"""For functions that others call."""
ONCE = {**PLAIN, "inline": "always"}
"""For those that are called from one place: compiled with their caller, not before it as well."""
OUTERMOST = {
    "fastmath": PLAIN["fastmath"],
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    "cache": True,
}
"""For those that Python calls. They alone are kept on disk, with all that they call."""


class _Format(NamedTuple):
    """Properties of a floating-point format that the exponential uses."""

    bits: int
    mantissa: int
    """bits of it"""
    bias: int
    """of the exponent"""
    ln2: tuple[float, float]
    """ln 2 as the sum of a number whose multiples are exact, and the rest"""
    degree: int
    """of the Taylor polynomial"""
    smallest: float
    """argument below which the result no longer falls"""


_LN2_64 = float.fromhex("0x1.62e42feep-1"), float.fromhex("0x1.a39ef35793c76p-33")
_LN2_32 = float.fromhex("0x1.62e4p-1"), math.log(2.0) - float.fromhex("0x1.62e4p-1")
_FORMATS = {
    types.float64: _Format(64, 52, 1023, _LN2_64, 12, -200.0),
    types.float32: _Format(32, 23, 127, _LN2_32, 7, -40.0),
}


@intrinsic
def exp(typing_context, x):
    """e^x for x <= 0, to within some units in the last place; 1 for x > 0, NaN for NaN.

    Far below, it stops falling (at e^-200, or at e^-40 in single precision), so that no product
    becomes subnormal, which would be slow.

    x = n ln 2 + r with abs(r) <= ln 2 / 2, and a Taylor polynomial for e^r. Adding 1.5 2^mantissa
    rounds to an integer, which then stands in the lowest bits.
    """
    form = _FORMATS[x]

    def generate(context, builder, signature, args):
        kind, integer = args[0].type, ir.IntType(form.bits)

        def number(value):
            return ir.Constant(kind, value)

        def bounded(x, comparison, bound):
            return builder.select(
                builder.fcmp_ordered(comparison, x, number(bound)), number(bound), x
            )

        x = bounded(bounded(args[0], ">", 0.0), "<", form.smallest)
        magic = number(1.5 * 2.0**form.mantissa)
        rounded = builder.fma(x, number(1 / math.log(2.0)), magic)
        n = builder.fsub(rounded, magic)
        r = builder.fma(n, number(-form.ln2[0]), x)
        r = builder.fma(n, number(-form.ln2[1]), r)
        y = number(1 / math.factorial(form.degree))
        for k in range(form.degree - 1, -1, -1):
            y = builder.fma(y, r, number(1 / math.factorial(k)))
        biased = builder.add(builder.bitcast(rounded, integer), integer(form.bias))
        power = builder.bitcast(builder.shl(biased, integer(form.mantissa)), kind)
        return builder.fmul(y, power)

    return x(x), generate


@njit(inline="always")
def mix(x):
    """The hash of `mcpilco.policies.policies.mix`, for one 32-bit integer."""
    x = uint32(x)
    x = uint32(x ^ uint32(x >> uint32(16)))
    x = uint32(x * uint32(0x7FEB352D))
    x = uint32(x ^ uint32(x >> uint32(15)))
    x = uint32(x * uint32(0x846CA68B))
    return uint32(x ^ uint32(x >> uint32(16)))


@njit(**PLAIN)
def clear(rows):
    """Zeros."""
    for i in range(rows.shape[0]):
        for p in range(rows.shape[1]):
            rows[i, p] = 0.0


@njit(**PLAIN)
def copy(source, out):
    """The same numbers: an assignment to a slice takes a second longer to compile."""
    for i in range(out.shape[0]):
        for p in range(out.shape[1]):
            out[i, p] = source[i, p]


@njit(**PLAIN)
def add(more, out):
    """out += more."""
    for i in range(out.shape[0]):
        for p in range(out.shape[1]):
            out[i, p] += more[i, p]


@njit(**PLAIN)
def set_exponentials(exponents, scale):
    """Scale times e^exponent, in place; exponents are not positive but for rounding."""
    for j in range(exponents.size):
        exponents[j] = scale * exp(exponents[j])
