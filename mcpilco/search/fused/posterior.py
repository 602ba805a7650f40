"""The posterior's share of a time step, compiled: kernel rows, samples and their derivatives.

The noise of a step is known when the step is taken, so that a sampled change and its derivative
come out of the same pass, with one product with L^-1 and one with L^-T for a block of particles,
each of a triangular matrix:

    delta = k . alpha + sd eps,    sd^2 = k** - |L^-1 k|^2,    u = L^-T L^-1 k = K^-1 k
    d delta / dx = sum_j g_j dk_j/dx + (eps / 2 sd) dk**/dx,    g = alpha - (eps / sd) u
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mcpilco.search.fused.arithmetic import ONCE, PLAIN, set_exponentials
from mcpilco.search.fused.tiles import multiply, multiply_lower, multiply_upper

_CHUNK_BYTES = 4096
"""of each array: numbers that pass through all operations before the next do, to stay in the
fastest cache"""


@njit(**PLAIN)
def _fill(out, value):
    for j in range(out.size):
        out[j] = value


@njit(**PLAIN)
def _copy(source, out):
    for j in range(out.size):
        out[j] = source[j]


@njit(**PLAIN)
def _multiply(out, factor):
    for j in range(out.size):
        out[j] *= factor[j]


@njit(**PLAIN)
def _add(out, more):
    for j in range(out.size):
        out[j] += more[j]


@njit(**PLAIN)
def _add_product(out, scale, a, b):
    for j in range(out.size):
        out[j] += scale * (a[j] * b[j])


@njit(**PLAIN)
def _set_scaled(source, scale, out):
    for j in range(out.size):
        out[j] = scale * source[j]


@njit(**PLAIN)
def _exchange(g, scale, a, b):
    """(a, b) = scale g (b, a)."""
    for j in range(g.size):
        common, first = scale * g[j], a[j]
        a[j] = common * b[j]
        b[j] = common * first


@njit(**PLAIN)
def _multiply_factors(out, first, last, skipped, factors, start):
    """Multiply by the factors from first to last, all but one (-1: all)."""
    for f in range(first, last):
        if f != skipped:
            _multiply(out, factors[f, start : start + out.size])


@njit(**PLAIN)
def _kernel(e, model, memory):
    """k(X, x) of one output, from its groups; exponents become exponentials."""
    exponent, ends, v = model.exponent, model.ends, model.v[e]
    groups, factors, kernel = memory.flat_groups, memory.flat_factors, memory.flat_kernel
    chunk = _CHUNK_BYTES // v.itemsize
    for start in range(0, kernel.size, chunk):
        stop = min(start + chunk, kernel.size)
        total, value = kernel[start:stop], memory.flat_term[: stop - start]
        _fill(total, 0.0)
        for k in range(v.size):
            first, last = ends[k], ends[k + 1]
            if exponent[k] >= 0:
                group = groups[exponent[k], start:stop]
                set_exponentials(group, v[k])
                if first == last:
                    _add(total, group)
                    continue
                _copy(group, value)
            elif last - first == 2:
                a, b = factors[first, start:stop], factors[first + 1, start:stop]
                _add_product(total, v[k], a, b)
                continue
            else:
                _fill(value, v[k])
            _multiply_factors(value, first, last, -1, factors, start)
            _add(total, value)


@njit(**PLAIN)
def _weigh(e, model, memory):
    """The groups, in place: g times its term for an exponent; without the factor for a factor."""
    exponent, ends, v = model.exponent, model.ends, model.v[e]
    groups, factors = memory.flat_groups, memory.flat_factors
    chunk = _CHUNK_BYTES // v.itemsize
    for start in range(0, memory.flat_solved.size, chunk):
        stop = min(start + chunk, memory.flat_solved.size)
        g = memory.flat_solved[start:stop]
        common, others = memory.flat_kernel[start:stop], memory.flat_term[: stop - start]
        for k in range(v.size):
            first, last = ends[k], ends[k + 1]
            if exponent[k] >= 0:
                h = groups[exponent[k], start:stop]
                _multiply(h, g)
                if first == last:
                    continue
                _copy(h, common)
                _multiply_factors(h, first, last, -1, factors, start)
            elif last - first == 2:
                _exchange(g, v[k], factors[first, start:stop], factors[first + 1, start:stop])
                continue
            else:
                _set_scaled(g, v[k], common)
            for f in range(first, last):  # `common` gathers the factors whose places are taken
                h = factors[f, start:stop]
                _copy(common, others)
                _multiply_factors(others, f + 1, last, -1, factors, start)
                _multiply(common, h)
                _copy(others, h)


@njit(**PLAIN)
def _prior(e, model, memory):
    """k(x, x) of one output, and its derivative in `slope`."""
    x, squares, slope, prior = memory.x, memory.squares, memory.slope, memory.prior
    v, c, s, ends = model.v[e], model.c[e], model.s[e], model.ends
    product = memory.term[0]
    _fill(prior, 0.0)
    for d in range(slope.shape[0]):
        _fill(slope[d], 0.0)
    for f in range(c.size):
        _fill(squares[f], c[f])
        for d in range(slope.shape[0]):
            for p in range(prior.size):
                squares[f, p] += s[f, d] * x[d, p] * x[d, p]
    for k in range(v.size):
        _fill(product, v[k])
        _multiply_factors(product, ends[k], ends[k + 1], -1, squares, 0)
        _add(prior, product)
        for f in range(ends[k], ends[k + 1]):
            _fill(product, v[k])
            _multiply_factors(product, ends[k], ends[k + 1], f, squares, 0)
            for d in range(slope.shape[0]):
                for p in range(prior.size):
                    slope[d, p] += 2.0 * product[p] * s[f, d] * x[d, p]


@njit(**PLAIN)
def _shift(e, model, memory):
    """The rows of x that complete the exponents of one output: -1/2 |x - middle|^2_w."""
    x, w, middle = memory.x, model.w[e], model.middle
    for k in range(model.exponent.size):
        if model.exponent[k] >= 0:
            row = x[middle.size + 1 + model.exponent[k]]
            _fill(row, 0.0)
            for d in range(middle.size):
                for p in range(row.size):
                    row[p] -= 0.5 * w[k, d] * (x[d, p] - middle[d]) ** 2


@njit(**PLAIN)
def _sample(e, eps, model, memory):
    """Sampled changes of one output, eps / sd as `ratio`, and g in place of u."""
    alpha, kernel, white, solved = model.alpha[e], memory.kernel, memory.white, memory.solved
    mean, explained, prior, ratio = memory.mean, memory.explained, memory.prior, memory.ratio
    floor, delta = model.floor[e], memory.delta[e]
    _fill(mean, 0.0)
    _fill(explained, 0.0)
    for j in range(alpha.size):
        for p in range(mean.size):
            mean[p] += alpha[j] * kernel[j, p]
            explained[p] += white[j, p] * white[j, p]
    for p in range(mean.size):
        variance = prior[p] - explained[p]
        clamped = not variance > floor
        sd = np.sqrt(floor if clamped else variance)
        delta[p] = mean[p] + sd * eps[p]
        ratio[p] = 0.0 if clamped else eps[p] / sd
    for j in range(alpha.size):
        for p in range(mean.size):
            solved[j, p] = alpha[j] - ratio[p] * solved[j, p]


@njit(**ONCE)
def _reweigh(weights, delta, memory):
    """Adds what each particle's own posterior has beyond alpha: to its change, and to g."""
    kernel, solved = memory.kernel, memory.solved
    for j in range(weights.shape[0]):
        for p in range(delta.size):
            delta[p] += weights[j, p] * kernel[j, p]
            solved[j, p] += weights[j, p]


@njit(**PLAIN)
def _differentiate(e, model, memory, jacobian):
    """d delta / dx of one output, from the sums over the samples and the prior's slope."""
    x, w, middle, moments = memory.x, model.w[e], model.middle, memory.moments
    ratio, slope = memory.ratio, memory.slope
    for d in range(middle.size):
        for p in range(ratio.size):
            jacobian[d, p] = 0.5 * ratio[p] * slope[d, p] + moments[d, p]
        for k in range(model.exponent.size):
            if model.exponent[k] >= 0:
                mass = moments[middle.size + model.exponent[k]]
                for p in range(ratio.size):
                    jacobian[d, p] -= w[k, d] * mass[p] * (x[d, p] - middle[d])


@njit(**ONCE)
def change(e, eps, weights, model, memory, jacobian):
    """Sampled changes of one output for a block of particles, and their derivatives."""
    _shift(e, model, memory)
    multiply(model.expand[e], memory.x, memory.groups)
    _kernel(e, model, memory)
    multiply_lower(model.whiten[e], memory.kernel, memory.white)
    multiply_upper(model.unwhiten[e], memory.white, memory.solved)
    _prior(e, model, memory)
    _sample(e, eps, model, memory)
    _reweigh(weights, memory.delta[e], memory)
    _weigh(e, model, memory)
    multiply(model.collect[e], memory.groups, memory.moments)
    _differentiate(e, model, memory, jacobian)
