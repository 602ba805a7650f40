"""The policy's share of a time step, compiled: augmentation, activations, dropout, squashing."""

from __future__ import annotations

import numpy as np
from numba import njit, uint32

from mcpilco.fused.arithmetic import PLAIN, mix, set_exponentials


@njit(**PLAIN)
def _augment(state, plain, angles, z):
    """z = [components that are no angle, cosines, sines] of one state."""
    for i in range(plain.size):
        z[i] = state[plain[i]]
    for i in range(angles.size):
        z[plain.size + i] = np.cos(state[angles[i]])
        z[plain.size + angles.size + i] = np.sin(state[angles[i]])


@njit(**PLAIN)
def _drop(key, particle, threshold, scale, phi):
    """Multiply the bases of one particle by their dropout factors, four bases a hash."""
    row = mix(uint32(uint32(particle) + key))
    level = uint32(threshold)
    for group in range(phi.size // 4):
        word = mix(uint32(row + uint32(uint32(group) * uint32(0x9E3779B9))))
        for lane in range(4):
            byte = uint32((word >> uint32(8 * lane)) & uint32(255))
            phi[4 * group + lane] *= 0.0 if byte < level else scale


@njit(**PLAIN)
def augment_block(size, states, policy, memory):
    """z of a block of particles in x, and [z / l, 1, -|z / l|^2] in `scaled`."""
    x, scaled, inv_scale = memory.x, memory.scaled, policy.inv_scale
    width = inv_scale.size
    for i in range(size):
        _augment(states[i], policy.plain, policy.angles, x[i, :width])
        square = 0.0
        for d in range(width):
            scaled[i, d] = x[i, d] * inv_scale[d]
            square += scaled[i, d] * scaled[i, d]
        scaled[i, width + 1] = -square


@njit(**PLAIN)
def activate_block(size, first, step, mask, phi):
    """Activations from exponents, with dropout."""
    for i in range(size):
        set_exponentials(phi[i], 1.0)
        if mask.threshold > 0:
            _drop(mask.keys[step], first + i, mask.threshold, mask.scale, phi[i])


@njit(**PLAIN)
def squash_block(size, policy, memory, inputs, input_jacobians):
    """The bounded inputs of a block of particles, in `inputs` and x, and du/dz.

    da/dz_d = -2 / l_d (z_d / l_d sum_b w_b phi_b - sum_b w_b phi_b c_bd / l_d), both sums in pulls
    """
    x, inv_scale, squash = memory.x, policy.inv_scale, policy.squash
    width = inv_scale.size
    for i in range(size):
        for j in range(inputs.shape[1]):
            pull = memory.pulls[i, j * (width + 1) : (j + 1) * (width + 1)]
            tangent = np.tanh(pull[width] / squash[2, j])
            inputs[i, j] = squash[0, j] + squash[1, j] * tangent
            x[i, width + j] = inputs[i, j]
            slope = squash[1, j] / squash[2, j] * (1.0 - tangent * tangent)
            for d in range(width):
                difference = x[i, d] * inv_scale[d] * pull[width] - pull[d]
                input_jacobians[i, j, d] = -2.0 * slope * inv_scale[d] * difference
