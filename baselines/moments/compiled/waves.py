"""Arithmetic of the compiled moments, and sines of a Gaussian: `baselines.moments.image`.

A joint Gaussian grows by the entries y = W sin(frequency * x[source] + shift) + offset.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
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


class Waves(NamedTuple):
    """Sines of entries of a joint Gaussian, and the linear map that follows them."""

    source: np.ndarray
    """(K,) which entry of the joint each wave sees"""
    frequency: np.ndarray
    """(K,)"""
    shift: np.ndarray
    """(K,) [rad]"""
    W: np.ndarray
    """(E, K)"""
    offset: np.ndarray
    """(E,)"""


@njit(**COMPILED)
def _growth(x, A):
    """exp(-A) (exp(x) - 1) for abs(x) <= A, without overflow."""
    return -math.exp(x - A) * math.expm1(-x) if x > 0 else math.exp(-A) * math.expm1(x)


@njit(**COMPILED)
def _arguments(waves, mean, cov):
    """Mean and covariance of what the sines are taken of."""
    source, frequency = waves.source, waves.frequency
    K = len(source)
    m, s = np.empty(K), np.empty((K, K))
    for k in range(K):
        m[k] = frequency[k] * mean[source[k]] + waves.shift[k]
        for j in range(K):
            s[k, j] = frequency[k] * frequency[j] * cov[source[k], source[j]]
    return m, s


@njit(**COMPILED)
def join(waves, first, mean, cov):
    """Fill the entries from `first` on of a joint's mean and covariance."""
    m, s = _arguments(waves, mean, cov)
    W, K, E = waves.W, len(m), len(waves.W)
    S, shrink = np.empty((K, K)), np.exp(-0.5 * np.diag(s))
    for k in range(K):
        for j in range(K):
            A = 0.5 * (s[k, k] + s[j, j])
            same = _growth(s[k, j], A) * math.cos(m[k] - m[j])
            S[k, j] = 0.5 * (same - _growth(-s[k, j], A) * math.cos(m[k] + m[j]))
    slope = waves.frequency * shrink * np.cos(m)
    for e in range(E):
        mean[first + e] = waves.offset[e]
        for k in range(K):
            mean[first + e] += W[e, k] * shrink[k] * math.sin(m[k])
        for i in range(first):
            cross = 0.0
            for k in range(K):
                cross += W[e, k] * slope[k] * cov[i, waves.source[k]]
            cov[i, first + e] = cov[first + e, i] = cross
        for f in range(E):
            total = 0.0
            for k in range(K):
                for j in range(K):
                    total += W[e, k] * S[k, j] * W[f, j]
            cov[first + e, first + f] = total


@njit(**COMPILED)
def join_back(waves, first, mean, cov, to_mean, to_cov):
    """Add to the gradients of the entries before `first` what comes from those after."""
    m, s = _arguments(waves, mean, cov)
    source, frequency, W, K, E = waves.source, waves.frequency, waves.W, len(m), len(waves.W)
    shrink = np.exp(-0.5 * np.diag(s))
    to_m, to_s = np.zeros(K), np.zeros((K, K))
    for k in range(K):
        slope, to_slope, to_M = shrink[k] * math.cos(m[k]), 0.0, 0.0
        for e in range(E):
            to_M += to_mean[first + e] * W[e, k]
        for i in range(first):
            to_cross = 0.0
            for e in range(E):
                to_cross += W[e, k] * (to_cov[i, first + e] + to_cov[first + e, i])
            to_slope += to_cross * frequency[k] * cov[i, source[k]]
            to_cov[i, source[k]] += to_cross * frequency[k] * slope
        M = shrink[k] * math.sin(m[k])
        to_m[k] += to_M * slope - to_slope * M
        to_s[k, k] -= 0.5 * (to_M * M + to_slope * slope)
    for k in range(K):
        for j in range(K):
            up = 0.0
            for e in range(E):
                for f in range(E):
                    up += W[e, k] * to_cov[first + e, first + f] * W[f, j]
            A = 0.5 * (s[k, k] + s[j, j])
            rising, falling = 0.5 * _growth(s[k, j], A), 0.5 * _growth(-s[k, j], A)
            same, opposite = math.cos(m[k] - m[j]), math.cos(m[k] + m[j])
            across, along = math.sin(m[k] - m[j]), math.sin(m[k] + m[j])
            to_m[k] += up * (falling * along - rising * across)
            to_m[j] += up * (falling * along + rising * across)
            base = 0.5 * math.exp(s[k, j] - A) * same + 0.5 * math.exp(-s[k, j] - A) * opposite
            to_s[k, j] += up * base
            half = 0.5 * up * (rising * same - falling * opposite)
            to_s[k, k] -= half
            to_s[j, j] -= half
    for k in range(K):
        to_mean[source[k]] += frequency[k] * to_m[k]
        for j in range(K):
            to_cov[source[k], source[j]] += frequency[k] * frequency[j] * to_s[k, j]
