"""The backward sweep, compiled: from d cost / d states to what the policy's gradient needs."""

from __future__ import annotations

import numpy as np
from numba import njit

from mcpilco.fused.arithmetic import OPTIONS, PLAIN


@njit(**PLAIN)
def backward(gradient_states, gradient_inputs, columns, trace, policy, model, scratch):
    """Adjoints of all particles, last step first; fills `columns` with d cost / da [1, z, z^2].

    With lambda the total derivative with respect to a state, and mu that with respect to an input:

        lambda_t = dc/dx_t + A^T lambda_{t+1} + (dz/dx)^T (J_z^T B^T lambda_{t+1} + (du/dz)^T mu_t)
        mu_t     = dc/du_t + J_u^T B^T lambda_{t+1}

    Shapes: gradient_states (T + 1, P, X), gradient_inputs (T, P, U), columns (T, P, U, 1 + 2 Z),
    scratch (3, X + E + Z + U).
    """
    steps, particles, count = gradient_inputs.shape
    plain, angles, squash, A, B = policy.plain, policy.angles, policy.squash, model.A, model.B
    width, outputs, z_width = A.shape[0], B.shape[1], policy.inv_scale.size
    following, current = scratch[0, :width], scratch[1, :width]
    gradient_delta = scratch[2, :outputs]
    gradient_z = scratch[2, outputs : outputs + z_width]
    mu = scratch[2, outputs + z_width : outputs + z_width + count]
    first_cosine, first_sine = plain.size, plain.size + angles.size
    for p in range(particles):
        for i in range(width):
            following[i] = gradient_states[steps, p, i]
        for t in range(steps - 1, -1, -1):
            state = trace.states[t, p]
            for i in range(width):
                current[i] = gradient_states[t, p, i]
            for d in range(z_width):
                gradient_z[d] = 0.0
            for i in range(count):
                mu[i] = gradient_inputs[t, p, i]
            if trace.frozen[t, p]:
                for i in range(width):
                    current[i] += following[i]
            else:
                for e in range(outputs):
                    gradient_delta[e] = 0.0
                    for i in range(width):
                        gradient_delta[e] += B[i, e] * following[i]
                for i in range(width):
                    for j in range(width):
                        current[j] += A[i, j] * following[i]
                for e in range(outputs):
                    jacobian = trace.delta_jacobians[t, p, e]
                    for d in range(z_width):
                        gradient_z[d] += jacobian[d] * gradient_delta[e]
                    for i in range(count):
                        mu[i] += jacobian[z_width + i] * gradient_delta[e]
            for i in range(count):
                for d in range(z_width):
                    gradient_z[d] += trace.input_jacobians[t, p, i, d] * mu[i]
                tangent = (trace.inputs[t, p, i] - squash[0, i]) / squash[1, i]
                column = columns[t, p, i]
                column[0] = mu[i] * squash[1, i] / squash[2, i] * (1.0 - tangent * tangent)
            for d in range(plain.size):
                current[plain[d]] += gradient_z[d]
                _add_powers(columns[t, p], d, state[plain[d]], z_width)
            for d in range(angles.size):
                cosine, sine = np.cos(state[angles[d]]), np.sin(state[angles[d]])
                current[angles[d]] += (
                    gradient_z[first_sine + d] * cosine - gradient_z[first_cosine + d] * sine
                )
                _add_powers(columns[t, p], first_cosine + d, cosine, z_width)
                _add_powers(columns[t, p], first_sine + d, sine, z_width)
            for i in range(width):
                following[i] = current[i]


@njit(**PLAIN)
def _add_powers(columns, d, z, width):
    """The entries of one component of z: d cost / d a times z and z^2."""
    for i in range(columns.shape[0]):
        columns[i, 1 + d] = columns[i, 0] * z
        columns[i, 1 + width + d] = columns[i, 0] * z * z


@njit(**OPTIONS)
def moments(activations, columns):
    """sum_tp phi_tpb da_tpu [1, z, z^2], of shape (B, U (1 + 2 Z)), from both flattened to rows."""
    return np.dot(activations.T, columns)
