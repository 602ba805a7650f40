"""The posterior's share of a time step, compiled: kernel rows, samples and their derivatives.

The noise of a step is known when the step is taken, so that a sampled change and its derivative
come out of the same pass, with one product with K^-1 for a block of particles (or two, through
L^-1, where K is ill-conditioned):

    delta = k . alpha + sd eps,    sd^2 = k** - k . u,    u = K^-1 k
    d delta / dx = sum_j g_j dk_j/dx + (eps / 2 sd) dk**/dx,    g = alpha - (eps / sd) u
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mcpilco.fused.arithmetic import PLAIN, set_exponentials


@njit(**PLAIN)
def _scale(source, factor, out):
    for j in range(out.size):
        out[j] = factor * source[j]


@njit(**PLAIN)
def _multiply(out, factor):
    for j in range(out.size):
        out[j] *= factor[j]


@njit(**PLAIN)
def _multiply_factors(out, groups, start, owner, term, skipped):
    """Multiply by the factors of a term, all but one (-1: all)."""
    first_factor = groups.shape[0] - owner.size
    for f in range(owner.size):
        if owner[f] == term and f != skipped:
            _multiply(out, groups[first_factor + f, start : start + out.size])


@njit(**PLAIN)
def kernel_block(e, count, model, memory):
    """k(x, X) of one output for a block, from its groups; exponents become exponentials."""
    groups, exponent, v = memory.groups, model.exponent, model.v[e]
    chunk = memory.term.size
    for start in range(0, count, chunk):
        stop = min(start + chunk, count)
        total = memory.rows[start:stop]
        for k in range(v.size):
            value = total if k == 0 else memory.term[: stop - start]
            if exponent[k] >= 0:
                group = groups[exponent[k], start:stop]
                set_exponentials(group, v[k])
                _scale(group, 1.0, value)
            else:
                for j in range(value.size):
                    value[j] = v[k]
            _multiply_factors(value, groups, start, model.owner, k, -1)
            if k > 0:
                for j in range(value.size):
                    total[j] += value[j]


@njit(**PLAIN)
def weigh_block(e, count, model, memory):
    """g times each term, for its exponent; g times the term less one factor, for that factor."""
    groups, weighted = memory.groups, memory.weighted
    exponent, owner, v = model.exponent, model.owner, model.v[e]
    first_factor = groups.shape[0] - owner.size
    chunk = memory.term.size
    for start in range(0, count, chunk):
        stop = min(start + chunk, count)
        g = memory.g[start:stop]
        for k in range(v.size):
            if exponent[k] >= 0:
                h = weighted[exponent[k], start:stop]
                _scale(g, 1.0, h)
                _multiply(h, groups[exponent[k], start:stop])
                _multiply_factors(h, groups, start, owner, k, -1)
        for f in range(owner.size):
            k, h = owner[f], weighted[first_factor + f, start:stop]
            if exponent[k] >= 0:
                _scale(g, 1.0, h)
                _multiply(h, groups[exponent[k], start:stop])
            else:
                _scale(g, v[k], h)
            _multiply_factors(h, groups, start, owner, k, f)


@njit(**PLAIN)
def _square_factor(x, c, s):
    """c + <x, x>_s."""
    value = c
    for d in range(x.size):
        value += s[d] * x[d] * x[d]
    return value


@njit(**PLAIN)
def _prior_variance(x, v, c, s, owner, slope):
    """k(x, x) of one output, and its derivative in `slope`."""
    total = 0.0
    for d in range(x.size):
        slope[d] = 0.0
    for k in range(v.size):
        value = v[k]
        for f in range(owner.size):
            if owner[f] == k:
                value *= _square_factor(x, c[f], s[f])
        total += value
        for f in range(owner.size):
            if owner[f] == k:
                others = v[k]
                for g in range(owner.size):
                    if owner[g] == k and g != f:
                        others *= _square_factor(x, c[g], s[g])
                for d in range(x.size):
                    slope[d] += 2.0 * others * s[f, d] * x[d]
    return total


@njit(**PLAIN)
def _dot(a, b):
    total = 0.0
    for j in range(a.size):
        total += a[j] * b[j]
    return total


@njit(**PLAIN)
def product_block(size, a, b, memory):
    """The inner product of each particle's rows, as its quadratic form."""
    for i in range(size):
        memory.quadratic[i] = _dot(a[i], b[i])


@njit(**PLAIN)
def _tilt(alpha, solved, ratio, g):
    """g = alpha - ratio u."""
    for j in range(g.size):
        g[j] = alpha[j] - ratio * solved[j]


@njit(**PLAIN)
def shift_block(e, size, model, memory):
    """The columns of x that complete the exponents of one output: -1/2 |x - middle|^2_w."""
    x, w, middle = memory.x, model.w[e], model.middle
    for k in range(model.exponent.size):
        if model.exponent[k] >= 0:
            for i in range(size):
                shift = 0.0
                for d in range(middle.size):
                    shift -= 0.5 * w[k, d] * (x[i, d] - middle[d]) ** 2
                x[i, middle.size + 1 + model.exponent[k]] = shift


@njit(**PLAIN)
def change_block(e, size, eps, model, memory):
    """Sampled changes of one output for a block, and the weights g of their derivatives."""
    alpha, n, width = model.alpha[e], model.alpha.shape[1], model.middle.size
    v, c, s, floor = model.v[e], model.c[e], model.s[e], model.floor[e]
    for i in range(size):
        row, u = memory.rows[i * n : (i + 1) * n], memory.solved[i]
        mean, quadratic = _dot(row, alpha), memory.quadratic[i]
        prior = _prior_variance(memory.x[i, :width], v, c, s, model.owner, memory.slope[i])
        clamped = not prior - quadratic > floor
        sd = np.sqrt(floor) if clamped else np.sqrt(prior - quadratic)
        ratio = 0.0 if clamped else eps[i, e] / sd
        memory.ratio[i] = ratio
        memory.delta[i, e] = mean + sd * eps[i, e]
        _tilt(alpha, u, ratio, memory.g[i * n : (i + 1) * n])


@njit(**PLAIN)
def collect_block(e, size, model, memory, jacobians):
    """d delta / dx of one output, from the sums over the samples and the prior variance's slope."""
    x, w, middle, moments = memory.x, model.w[e], model.middle, memory.moments
    for i in range(size):
        jacobian = jacobians[i, e]
        for d in range(middle.size):
            jacobian[d] = 0.5 * memory.ratio[i] * memory.slope[i, d]
            for group in range(moments.shape[0]):
                jacobian[d] += moments[group, i, d]
        for k in range(model.exponent.size):
            if model.exponent[k] >= 0:
                mass = moments[model.exponent[k], i, middle.size]
                for d in range(middle.size):
                    jacobian[d] -= w[k, d] * mass * (x[i, d] - middle[d])


@njit(**PLAIN)
def advance_block(size, model, memory, states, following, frozen):
    """x' = A x + B delta of a block, or x where that is implausible; frozen tells which."""
    A, B, predicted, bounds = model.A, model.B, model.predicted, model.bounds
    for i in range(size):
        for row in range(A.shape[0]):
            value = 0.0
            for column in range(A.shape[1]):
                value += A[row, column] * states[i, column]
            for e in range(B.shape[1]):
                value += B[row, e] * memory.delta[i, e]
            following[i, row] = value
        frozen[i] = 0
        for e in range(predicted.size):
            if not abs(following[i, predicted[e]]) <= bounds[e]:
                frozen[i] = 1
        if frozen[i]:
            for row in range(A.shape[0]):
                following[i, row] = states[i, row]
