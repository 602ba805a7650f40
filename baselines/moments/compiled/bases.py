"""Gaussian bases behind a Gaussian: `baselines.moments.image`, whose letters these are.

The gradient to each entry of S is that entry's, times numbers that the way forward can sum up: what
is as large as N x N is not kept.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from baselines.moments.compiled.waves import COMPILED, expm1, invert


class Functions(NamedTuple):
    """`baselines.moments.image.Bases` as arrays; K = E outputs and then Q pairs."""

    centres: np.ndarray
    """(N, D)"""
    widths: np.ndarray
    """(K, D)"""
    variance: np.ndarray
    """(E,)"""
    weights: np.ndarray
    """(E, N)"""
    inverse: np.ndarray
    """(E, N, N), or (0, N, N) where the functions are known"""
    pairs: np.ndarray
    """(2, Q)"""


class Trace(NamedTuple):
    """The terms of one step that its derivatives need; a leading axis in front holds all steps."""

    F: np.ndarray
    """(K, D, D)"""
    q: np.ndarray
    """(E, N)"""
    slope: np.ndarray
    """(D, E): V"""
    rows: np.ndarray
    """(Q, N): sums over the rows of H = mass e^delta"""
    columns: np.ndarray
    """(Q, N)"""
    Hzb: np.ndarray
    """(Q, N, D): H z_b"""
    Hza: np.ndarray
    """(Q, N, D): H^T z_a"""
    of_b: np.ndarray
    """(Q, N): (e^delta - 1) w_b"""
    of_a: np.ndarray
    """(Q, N): (e^delta - 1)^T w_a"""
    grown: np.ndarray
    """(E, N): (K^-1 * e^delta) q"""


def trace(functions: Functions, steps: int) -> Trace:
    """Memory for so many steps."""
    (N, D), K, E = functions.centres.shape, len(functions.widths), len(functions.variance)
    Q = K - E
    shapes = ((K, D, D), (E, N), (D, E), (Q, N), (Q, N), (Q, N, D), (Q, N, D), (Q, N), (Q, N))
    return Trace(*(np.zeros((steps, *shape)) for shape in (*shapes, (E, N))))


@njit(**COMPILED)
def _parts(functions, entries, mean, cov):
    """nu (N, D), z (E, N, D) and s (D, D)."""
    N, D = functions.centres.shape
    E = len(functions.variance)
    nu, z, s = np.empty((N, D)), np.empty((E, N, D)), np.empty((D, D))
    for d in range(D):
        for c in range(D):
            s[d, c] = cov[entries[d], entries[c]]
        for i in range(N):
            nu[i, d] = functions.centres[i, d] - mean[entries[d]]
            for e in range(E):
                z[e, i, d] = nu[i, d] / functions.widths[e, d]
    return nu, z, s


@njit(**COMPILED)
def join(functions, entries, first, mean, cov, trace, t):
    """Fill the entries from `first` on of a joint; returns whether s is a covariance.

    Functions are of the inputs `entries` (D,) of the joint of mean (J,) and cov (J, J); `first` is
    the number of entries before; the trace is of all steps, of which t is this one.
    """
    nu, z, s = _parts(functions, entries, mean, cov)
    (N, D), K, E = functions.centres.shape, len(functions.widths), len(functions.variance)
    F, q, slope = trace.F[t], trace.q[t], trace.slope[t]
    T, log_det, A = np.empty((K, D, D)), np.empty(K), np.empty((D, D))
    for k in range(K):
        A[:] = s
        for d in range(D):
            A[d, d] += functions.widths[k, d]
        positive, log_det[k] = invert(A, F[k])
        if not positive:
            return False
        log_det[k] -= np.log(functions.widths[k]).sum()
        T[k] = np.dot(F[k], s)
        for d in range(D):
            T[k, d] *= functions.widths[k, d]

    w, own = np.empty((E, N)), np.empty((E, N, D))
    for e in range(E):
        r = np.dot(nu, F[e])
        own[e] = np.dot(z[e], T[e])
        slope[:, e] = 0.0
        mean[first + e] = 0.0
        for i in range(N):
            exponent = log_det[e]
            for d in range(D):
                exponent += r[i, d] * nu[i, d]
            q[e, i] = functions.variance[e] * np.exp(-0.5 * exponent)
            w[e, i] = functions.weights[e, i] * q[e, i]
            mean[first + e] += w[e, i]
            for d in range(D):
                slope[d, e] += w[e, i] * r[i, d]
        for j in range(first):
            cross = 0.0
            for d in range(D):
                cross += cov[j, entries[d]] * slope[d, e]
            cov[j, first + e] = cov[first + e, j] = cross

    for p in range(K - E):
        a, b = functions.pairs[0, p], functions.pairs[1, p]
        constant = log_det[a] + log_det[b] - log_det[E + p]
        value = _pair(functions, trace, t, p, z, w, own, T[E + p], constant)
        if a == b and len(functions.inverse):
            value += functions.variance[a] - np.dot(q[a], np.dot(functions.inverse[a], q[a]))
        cov[first + a, first + b] = cov[first + b, first + a] = value
    return True


@njit(**COMPILED)
def _pair(functions, trace, t, p, z, w, own, T, constant):
    """The covariance of two means, less the known part of a variance; fills the trace."""
    a, b = functions.pairs[0, p], functions.pairs[1, p]
    N, D = functions.centres.shape
    zaT, zbT = np.dot(z[a], T), np.dot(z[b], T)
    column, row = np.empty(N), np.empty(N)
    for i in range(N):
        column[i], row[i] = constant, 0.0
        for d in range(D):
            column[i] += (zaT[i, d] - own[a, i, d]) * z[a, i, d]
            row[i] += (zbT[i, d] - own[b, i, d]) * z[b, i, d]
    growth = np.dot(zaT, z[b].T)
    H = np.empty((N, N))
    certain, q = len(functions.inverse) == 0 or a != b, trace.q[t, a]
    of_a, columns = np.zeros(N), np.zeros(N)
    value = 0.0
    for i in range(N):
        total, of_b, part, grown = 0.0, 0.0, 0.0, 0.0
        if certain:
            for j in range(N):
                e = expm1(growth[i, j] + 0.5 * (column[i] + row[j]))
                mass = w[a, i] * w[b, j]
                H[i, j] = mass * (e + 1.0)
                part += mass * e
                total += H[i, j]
                of_b += e * w[b, j]
                of_a[j] += e * w[a, i]
                columns[j] += H[i, j]
        else:
            for j in range(N):
                e = expm1(growth[i, j] + 0.5 * (column[i] + row[j]))
                known = functions.inverse[a, i, j] * q[j]
                mass = w[a, i] * w[b, j] - known * q[i]
                H[i, j] = mass * (e + 1.0)
                part += mass * e
                total += H[i, j]
                of_b += e * w[b, j]
                of_a[j] += e * w[a, i]
                columns[j] += H[i, j]
                grown += known * (e + 1.0)
            trace.grown[t, a, i] = grown
        trace.rows[t, p, i], trace.of_b[t, p, i] = total, of_b
        value += part
    trace.of_a[t, p], trace.columns[t, p] = of_a, columns
    trace.Hzb[t, p], trace.Hza[t, p] = np.dot(H, z[b]), np.dot(H.T, z[a])
    return value


@njit(**COMPILED)
def join_back(functions, entries, first, mean, cov, to_mean, to_cov, trace, t, learned):
    """Add to the gradients of the entries before `first` what comes from those after.

    Arguments are those of `join`, with gradients to M, s and each of its entries; `learned` are
    those to the functions' centres (N, D), widths (K, D) and weights (E, N), to be added to; empty
    arrays where these are constants.
    """
    nu, z, s = _parts(functions, entries, mean, cov)
    (N, D), K, E = functions.centres.shape, len(functions.widths), len(functions.variance)
    D_, F, q, slope = functions.widths, trace.F[t], trace.q[t], trace.slope[t]
    T, to_T, to_log_det = np.empty((K, D, D)), np.zeros((K, D, D)), np.zeros(K)
    for k in range(K):
        T[k] = np.dot(F[k], s)
        for d in range(D):
            T[k, d] *= D_[k, d]

    # the joint: cov(z, y) = cov(z, x) V
    to_slope = np.zeros((D, E))
    for j in range(first):
        for e in range(E):
            to_cross = to_cov[j, first + e] + to_cov[first + e, j]
            for d in range(D):
                to_slope[d, e] += cov[j, entries[d]] * to_cross
                to_cov[j, entries[d]] += slope[d, e] * to_cross

    # S, by way of delta
    to_z, to_w, to_q = np.zeros((E, N, D)), np.zeros((E, N)), np.zeros((E, N))
    own = np.empty((E, N, D))
    for e in range(E):
        own[e] = np.dot(z[e], T[e])
        to_w[e] = to_mean[first + e]
    for p in range(K - E):
        a, b = functions.pairs[0, p], functions.pairs[1, p]
        up = to_cov[first + a, first + b]
        if a != b:
            up += to_cov[first + b, first + a]
        Hzb, Hza = trace.Hzb[t, p], trace.Hza[t, p]
        to_T[E + p] += up * np.dot(z[a].T, Hzb)
        fromb, froma = np.dot(Hzb, T[E + p]), np.dot(Hza, T[E + p])
        zaT, zbT = np.dot(z[a], T[E + p]), np.dot(z[b], T[E + p])
        for i in range(N):
            row, column = up * trace.rows[t, p, i], up * trace.columns[t, p, i]
            to_log_det[E + p] -= 0.5 * row
            to_log_det[a] += 0.5 * row
            to_log_det[b] += 0.5 * row
            to_w[a, i] += up * trace.of_b[t, p, i]
            to_w[b, i] += up * trace.of_a[t, p, i]
            if a == b and len(functions.inverse):
                to_q[a, i] -= 2.0 * up * trace.grown[t, a, i]
            for d in range(D):
                to_z[a, i, d] += row * (zaT[i, d] - own[a, i, d]) + up * fromb[i, d]
                to_z[b, i, d] += column * (zbT[i, d] - own[b, i, d]) + up * froma[i, d]
                for c in range(D):
                    of_a = 0.5 * row * z[a, i, d] * z[a, i, c]
                    of_b = 0.5 * column * z[b, i, d] * z[b, i, c]
                    to_T[E + p, d, c] += of_a + of_b
                    to_T[a, d, c] -= of_a
                    to_T[b, d, c] -= of_b

    # w and q, F and nu; then s by way of dF = -F ds F, dT = D F ds F D
    to_nu, to_s = np.zeros((N, D)), np.zeros((D, D))
    to_centres, to_widths, to_weights = learned
    for e in range(E):
        to_F = np.zeros((D, D))
        r = np.dot(nu, F[e])
        pull = np.dot(F[e], to_slope[:, e].copy())
        for i in range(N):
            w = functions.weights[e, i] * q[e, i]
            for d in range(D):
                to_w[e, i] += r[i, d] * to_slope[d, e]
            to_q[e, i] += functions.weights[e, i] * to_w[e, i]
            to_log_q = to_q[e, i] * q[e, i]
            to_log_det[e] -= 0.5 * to_log_q
            for d in range(D):
                to_nu[i, d] += to_z[e, i, d] / D_[e, d] - to_log_q * r[i, d] + w * pull[d]
                for c in range(D):
                    by_q = -0.5 * to_log_q * nu[i, d] * nu[i, c]
                    to_F[d, c] += by_q + w * nu[i, d] * to_slope[c, e]
        if len(to_weights):
            to_weights[e] += q[e] * to_w[e]
            for i in range(N):
                for d in range(D):
                    to_widths[e, d] -= to_z[e, i, d] * z[e, i, d] / D_[e, d]
        to_s -= np.dot(F[e], np.dot(to_F, F[e]))
        if len(to_weights):
            to_widths[e] -= np.diag(np.dot(F[e], np.dot(to_F, F[e])))
    for k in range(K):
        inner = to_T[k].copy()
        for d in range(D):
            for c in range(D):
                inner[d, c] *= D_[k, d] * D_[k, c]
        to_s += np.dot(F[k], np.dot(inner, F[k])) + to_log_det[k] * F[k]
        if len(to_weights):
            Fs = np.dot(F[k], s)
            to_widths[k] += np.diag(np.dot(Fs, np.dot(to_T[k], Fs.T)))
            to_widths[k] += to_log_det[k] * (np.diag(F[k]) - 1.0 / D_[k])
    if len(to_weights):
        to_centres += to_nu
    for d in range(D):
        for i in range(N):
            to_mean[entries[d]] -= to_nu[i, d]
        for c in range(D):
            to_cov[entries[d], entries[c]] += to_s[d, c]
