"""Sines behind a Gaussian: `baselines.moments.sines` and the joint of `baselines.moments.image`.

A joint Gaussian grows by the entries y = W sin(frequency * x[source] + shift) + offset.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from baselines.moments.compiled.arithmetic import COMPILED


class Waves(NamedTuple):
    """What the sines are of, and what is made of them."""

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
