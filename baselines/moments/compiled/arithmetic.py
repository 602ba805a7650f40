"""Arithmetic of the compiled moments: an exponential that vectorises, small inverses."""

from __future__ import annotations

import math

from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

OUTERMOST = {"fastmath": {"reassoc", "contract", "nsz"}, "error_model": "numpy", "cache": True}
"""For functions that Python calls: they alone are kept on disk, with all that they call."""
COMPILED = OUTERMOST | {"cache": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""For those that others call."""

_LN2 = float.fromhex("0x1.62e42feep-1"), float.fromhex("0x1.a39ef35793c76p-33")
"""ln 2 as the sum of a number whose multiples are exact, and the rest"""
_DEGREE = 13
_SMALLEST, _LARGEST = -700.0, 700.0


@intrinsic
def expm1(typing_context, x):
    """e^x - 1, to within some units in the last place; for abs(x) > 700 as if it were 700.

    x = n ln 2 + r with abs(r) <= ln 2 / 2, a Taylor polynomial p for e^r - 1, and
    e^x - 1 = 2^n p + (2^n - 1). Adding 1.5 2^52 rounds to an integer, which then stands in the
    lowest bits.
    """

    def generate(context, builder, signature, args):
        kind, integer = args[0].type, ir.IntType(64)

        def number(value):
            return ir.Constant(kind, value)

        x = args[0]
        for comparison, bound in ((">", _LARGEST), ("<", _SMALLEST)):
            beyond = builder.fcmp_ordered(comparison, x, number(bound))
            x = builder.select(beyond, number(bound), x)
        rounded = builder.fma(x, number(1 / math.log(2.0)), number(1.5 * 2.0**52))
        n = builder.fsub(rounded, number(1.5 * 2.0**52))
        r = builder.fma(n, number(-_LN2[0]), x)
        r = builder.fma(n, number(-_LN2[1]), r)
        y = number(1 / math.factorial(_DEGREE))
        for k in range(_DEGREE - 1, 0, -1):
            y = builder.fma(y, r, number(1 / math.factorial(k)))
        p = builder.fmul(y, r)
        biased = builder.add(builder.bitcast(rounded, integer), integer(1023))
        power = builder.bitcast(builder.shl(biased, integer(52)), kind)
        return builder.fma(power, p, builder.fsub(power, number(1.0)))

    return x(types.float64), generate


@njit(**COMPILED)
def invert(A, inverse):
    """Put the inverse of a positive definite A into `inverse`; returns whether it is, and log |A|.

    By A = L L^T and A^-1 = L^-T L^-1; A is overwritten.
    """
    size, log_det = len(A), 0.0
    for j in range(size):
        pivot = A[j, j]
        for k in range(j):
            pivot -= A[j, k] ** 2
        if not pivot > 0.0:
            return False, 0.0
        A[j, j] = math.sqrt(pivot)
        log_det += math.log(pivot)
        for i in range(j + 1, size):
            rest = A[i, j]
            for k in range(j):
                rest -= A[i, k] * A[j, k]
            A[i, j] = rest / A[j, j]
    for j in range(size):  # column j of L^-1, from its diagonal down
        for i in range(j, size):
            rest = 1.0 if i == j else 0.0
            for k in range(j, i):
                rest -= A[i, k] * inverse[k, j]
            inverse[i, j] = rest / A[i, i]
    for i in range(size):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, size):
                total += inverse[k, i] * inverse[k, j]
            A[i, j] = total
    for i in range(size):
        for j in range(i + 1):
            inverse[i, j] = inverse[j, i] = A[i, j]
    return True, log_det
