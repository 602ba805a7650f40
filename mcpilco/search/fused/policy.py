"""The policy's share of a time step, compiled: augmentation, activations, dropout, squashing."""

from __future__ import annotations

import numpy as np
from numba import njit, uint32

from mcpilco.search.fused.arithmetic import ONCE, OUTERMOST, PLAIN, exp, mix, set_exponentials
from mcpilco.search.fused.tiles import multiply


@njit(**OUTERMOST)
def prepare(centres, log_scale, weights, policy):
    """Fill the arrays of a policy from its parameters: (B, Z), (Z,), (B, U).

    -|z / l - c / l|^2 = 2 <z / l, c / l> - |c / l|^2 - |z / l|^2
    """
    inv_scale, height, low = policy.inv_scale, policy.centres.shape[2], policy.pulling.shape[2]
    width = inv_scale.size
    for d in range(width):
        inv_scale[d] = np.exp(-log_scale[d])
    for b in range(centres.shape[0]):
        panel, row = policy.centres[b // height], b % height
        panel[width, row], panel[width + 1, row] = 0.0, 1.0
        for d in range(width):
            c = centres[b, d] * inv_scale[d]
            panel[d, row] = 2.0 * c
            panel[width, row] -= c * c
            for j in range(weights.shape[1]):
                pull = j * (width + 1) + d
                policy.pulling[pull // low, b, pull % low] = weights[b, j] * c
        for j in range(weights.shape[1]):
            pull = j * (width + 1) + width
            policy.pulling[pull // low, b, pull % low] = weights[b, j]


@njit(**OUTERMOST)
def differentiate(centres, log_scale, weights, moments, by_centres, by_log_scale, by_weights):
    """The gradients of the parameters, from the moments (B, U (1 + 2 Z)): sum phi da [1, z, z^2].

    dphi_b/dc_bd = 2 phi_b (z_d - c_bd) / l_d^2,   dphi_b/dlog l_d = 2 phi_b (z_d - c_bd)^2 / l_d^2
    """
    bases, width = centres.shape
    for d in range(width):
        by_log_scale[d] = 0.0
    for b in range(bases):
        for d in range(width):
            by_centres[b, d] = 0.0
        for j in range(weights.shape[1]):
            row = moments[b, j * (1 + 2 * width) : (j + 1) * (1 + 2 * width)]
            by_weights[b, j] = row[0]
            for d in range(width):
                c, factor = centres[b, d], 2.0 * weights[b, j] * np.exp(-2.0 * log_scale[d])
                first, second = row[1 + d], row[1 + width + d]
                by_centres[b, d] += factor * (first - c * row[0])
                by_log_scale[d] += factor * (second - 2.0 * c * first + c * c * row[0])


@njit(**PLAIN)
def augment(state, policy, z):
    """z = [components that are no angle, cosines, sines]."""
    plain, angles, width = policy.plain, policy.angles, z.shape[1]
    for i in range(plain.size):
        for p in range(width):
            z[i, p] = state[plain[i], p]
    for i in range(angles.size):
        cosine, sine = z[plain.size + i], z[plain.size + angles.size + i]
        for p in range(width):
            cosine[p] = np.cos(state[angles[i], p])
            sine[p] = np.sin(state[angles[i], p])


@njit(**PLAIN)
def through_augmentation(policy, values, z, current):
    """From z to the state, which is added to."""
    plain, angles = policy.plain, policy.angles
    for d in range(plain.size):
        for p in range(z.shape[1]):
            current[plain[d], p] += z[d, p]
    for d in range(angles.size):
        cosine, sine = plain.size + d, plain.size + angles.size + d
        for p in range(z.shape[1]):
            along = z[sine, p] * values[cosine, p]
            current[angles[d], p] += along - z[cosine, p] * values[sine, p]


@njit(**ONCE)
def _scale(policy, memory):
    """[z / l, 1, -|z / l|^2]."""
    z, scaled, inv_scale, width = memory.z, memory.scaled, policy.inv_scale, memory.z.shape[1]
    ones, squares = scaled[inv_scale.size], scaled[inv_scale.size + 1]
    for p in range(width):
        ones[p] = 1.0
        squares[p] = 0.0
    for d in range(inv_scale.size):
        for p in range(width):
            scaled[d, p] = z[d, p] * inv_scale[d]
            squares[p] -= scaled[d, p] * scaled[d, p]


@njit(**PLAIN)
def _set_dropped(row, word, shift, limit, scale):
    """Scale times e^row, or 0 where the byte of the hash that `shift` brings up is too small."""
    zero = scale - scale
    for p in range(row.size):
        byte = uint32(word[p] << shift)
        row[p] = exp(row[p]) * (zero if byte < limit else scale)


@njit(**ONCE)
def _drop(key, first, mask, words, phi):
    """Activations from exponents, times their dropout factors, four bases a hash."""
    rows, word = words[0], words[1]
    limit = uint32(uint32(mask.threshold) << uint32(24))
    for p in range(rows.size):
        rows[p] = mix(uint32(uint32(first + p) + key))
    for group in range(phi.shape[0] // 4):
        offset = uint32(uint32(group) * uint32(0x9E3779B9))
        for p in range(word.size):
            word[p] = mix(uint32(rows[p] + offset))
        for lane in range(4):
            shift = uint32(24 - 8 * lane)
            _set_dropped(phi[4 * group + lane], word, shift, limit, mask.scale[0])


@njit(**PLAIN)
def activate(state, first, step, mask, policy, memory):
    """The activations of a block of particles, dropout included; z on the way."""
    augment(state, policy, memory.z)
    _scale(policy, memory)
    multiply(policy.centres, memory.scaled, memory.phi)
    if mask.threshold > 0:
        _drop(mask.keys[step], first, mask, memory.words, memory.phi)
    else:
        set_exponentials(memory.flat_phi, memory.phi.dtype.type(1.0))


@njit(**ONCE)
def act(policy, memory, inputs, jacobian):
    """The bounded inputs of a block of particles, from its activations, and du/dz.

    da/dz_d = -2 / l_d (z_d / l_d sum_b w_b phi_b - sum_b w_b phi_b c_bd / l_d), both sums in pulls
    """
    inv_scale, squash, scaled, pulls = policy.inv_scale, policy.squash, memory.scaled, memory.pulls
    slope = memory.slope
    multiply(policy.pulling, memory.phi, pulls)
    for j in range(inputs.shape[0]):
        first = j * (inv_scale.size + 1)
        total, ratio = pulls[first + inv_scale.size], squash[1, j] / squash[2, j]
        for p in range(total.size):
            tangent = np.tanh(total[p] / squash[2, j])
            inputs[j, p] = squash[0, j] + squash[1, j] * tangent
            slope[p] = -2.0 * ratio * (1.0 - tangent * tangent)
        for d in range(inv_scale.size):
            pull = pulls[first + d]
            for p in range(total.size):
                difference = scaled[d, p] * total[p] - pull[p]
                jacobian[j, d, p] = slope[p] * inv_scale[d] * difference
