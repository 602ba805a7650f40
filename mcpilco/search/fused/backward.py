"""The backward sweep, compiled: from d cost / d states to what the policy's gradient needs."""

from __future__ import annotations

from numba import njit

from mcpilco.compiling import digest
from mcpilco.search.fused import sensing as seen
from mcpilco.search.fused.arithmetic import ONCE, OUTERMOST, PLAIN, add, copy
from mcpilco.search.fused.policy import activate
from mcpilco.search.fused.program import clear_adjoints, load, prepare, run, run_back
from mcpilco.search.fused.tiles import add_product


@njit(**ONCE)
def _through_flow(frozen, model, adjoint):
    """From the next state to the state of A x, which is added to."""
    following, current, A = adjoint.following, adjoint.current, model.A
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            same = 1.0 if i == j else 0.0
            for p in range(frozen.size):
                current[j, p] += (same if frozen[p] else A[i, j]) * following[i, p]


@njit(**ONCE)
def _through_memory(frozen, memory, adjoint):
    """From the next state to the inputs of C u, which are added to."""
    following, mu = adjoint.following, adjoint.mu
    for i in range(memory.shape[0]):
        for j in range(memory.shape[1]):
            for p in range(frozen.size):
                mu[j, p] += 0.0 if frozen[p] else memory[i, j] * following[i, p]


@njit(**PLAIN)
def _through_program(state, inputs, program, memory, adjoint):
    """From the results, whose adjoints are set, to the state and the inputs, which are added to."""
    load(program, state, inputs, memory)
    run(program, memory)
    run_back(program, memory)
    current, mu = adjoint.current, adjoint.mu
    add(memory.adjoints[: current.shape[0]], current)
    add(memory.adjoints[current.shape[0] : current.shape[0] + mu.shape[0]], mu)


@njit(**PLAIN)
def _through_brake(brake, memory, state, commands, sensing, sensing_memory, adjoint):
    """From the inputs to the commands, in their place, and to the state, which is added to."""
    if brake is None:
        return
    mu, width = adjoint.mu, state.shape[0]
    clear_adjoints(memory)
    for i in range(brake.outputs.size):
        result = memory.adjoints[brake.outputs[i]]
        for p in range(result.size):
            result[p] += mu[i, p]
    load(brake, state, commands, memory)
    run(brake, memory)
    run_back(brake, memory)
    copy(memory.adjoints[width : width + mu.shape[0]], mu)
    seen.add_acted_on(sensing, memory.adjoints[:width], sensing_memory, adjoint)


@njit(**PLAIN)
def _through_motion(drift, memory, model, state, inputs, frozen, adjoint):
    """From the next state to the state and the inputs, without the GPs' changes."""
    if drift is None:
        _through_flow(frozen, model, adjoint)
        _through_memory(frozen, model.C, adjoint)
        return
    following, current = adjoint.following, adjoint.current
    clear_adjoints(memory)
    for i in range(drift.outputs.size):
        result = memory.adjoints[drift.outputs[i]]
        for p in range(frozen.size):
            result[p] += 0.0 if frozen[p] else following[i, p]
            current[i, p] += following[i, p] if frozen[p] else 0.0
    _through_program(state, inputs, drift, memory, adjoint)


@njit(**PLAIN)
def _through_features(features, memory, state, inputs, jacobian, frozen, adjoint):
    """From the changes through the further regressors, if any, to the state and the inputs."""
    if features is None:
        return
    delta, at = adjoint.delta, adjoint.z.shape[0] + adjoint.mu.shape[0]
    clear_adjoints(memory)
    for i in range(features.outputs.size):
        result = memory.adjoints[features.outputs[i]]
        for e in range(delta.shape[0]):
            for p in range(frozen.size):
                result[p] += 0.0 if frozen[p] else jacobian[e, at + i, p] * delta[e, p]
    _through_program(state, inputs, features, memory, adjoint)


@njit(**ONCE)
def _through_changes(jacobian, frozen, model, adjoint):
    """From the next state through the changes to z, and, added to what is there, to the inputs."""
    following, z, mu = adjoint.following, adjoint.z, adjoint.mu
    B, delta = model.B, adjoint.delta
    for d in range(z.shape[0]):
        for p in range(frozen.size):
            z[d, p] = 0.0
    for e in range(B.shape[1]):
        for p in range(frozen.size):
            delta[e, p] = 0.0
        for i in range(B.shape[0]):
            for p in range(frozen.size):
                delta[e, p] += B[i, e] * following[i, p]
        for d in range(z.shape[0]):
            for p in range(frozen.size):
                z[d, p] += 0.0 if frozen[p] else jacobian[e, d, p] * delta[e, p]
        for i in range(mu.shape[0]):
            for p in range(frozen.size):
                more = jacobian[e, z.shape[0] + i, p] * delta[e, p]
                mu[i, p] += 0.0 if frozen[p] else more


@njit(**ONCE)
def _through_policy(inputs, jacobian, policy, values, adjoint):
    """From the inputs to z; d cost / da [1, z, z^2] of each particle in `columns`."""
    z, mu, columns, squash = adjoint.z, adjoint.mu, adjoint.columns, policy.squash
    for i in range(mu.shape[0]):
        for d in range(z.shape[0]):
            for p in range(z.shape[1]):
                z[d, p] += jacobian[i, d, p] * mu[i, p]
        first = i * (1 + 2 * z.shape[0])
        for p in range(z.shape[1]):
            tangent = (inputs[i, p] - squash[0, i]) / squash[1, i]
            pull = mu[i, p] * squash[1, i] / squash[2, i] * (1.0 - tangent * tangent)
            row = columns[p]
            row[first] = pull
            for d in range(z.shape[0]):
                row[first + 1 + d] = pull * values[d, p]
                row[first + 1 + z.shape[0] + d] = pull * values[d, p] * values[d, p]


def _compiled(sources: str):
    @njit(**OUTERMOST)
    def backward(start, stop, gradient_states, gradient_inputs, arrays, memories, moments):
        """Adjoints of particles, last step first; adds up the policy's moments.

        With lambda the total derivative with respect to a state, and mu that with respect to an
        input:

            lambda_t = dc/dx_t + A^T lambda_{t+1}
                       + (dz/dx)^T (J_z^T B^T lambda_{t+1} + (du/dz)^T mu_t)
            mu_t     = dc/du_t + J_u^T B^T lambda_{t+1}

        Where the policy acts on estimates, (du/dz)^T mu_t goes through these instead, see
        `mcpilco.search.fused.sensing`; each row of a particle then has a lambda of its own.

        The activations are computed anew, which takes less time than to store them.

        Particles are those from start to stop, in blocks as wide as the memory. `arrays` are those
        of the forward sweep, `memories` are of policy, adjoints, physics and sensing. Shapes:
        gradient_states (T + 1, X, P), gradient_inputs (T, U, P), moments (B padded, U (1 + 2 Z)
        padded): sum_tp phi_tpb da_tpu [1, z, z^2].
        """
        sources  # noqa: B018
        mask, policy, model, physics, sensing, trace = arrays
        memory, adjoint, physics_memory, sensing_memory = memories
        outputs, width_x, width = model.B.shape[1], model.A.shape[0], memory.slope.size
        moved, acted_on = trace.frozen.shape[1], trace.states.shape[1] - width_x
        for first in range(start, stop, width):
            last = first + width
            copy(gradient_states[len(gradient_inputs), :, first:last], adjoint.current)
            seen.begin_back(sensing, sensing_memory)
            prepare(policy.brake, first, memory.brake)
            prepare(physics.drift, first, physics_memory.drift)
            prepare(physics.features, first, physics_memory.features)
            for t in range(len(gradient_inputs) - 1, -1, -1):
                gradient = gradient_states[t, :, first:last]
                copy(adjoint.current, adjoint.following)
                copy(gradient, adjoint.current)
                copy(gradient_inputs[t, :, first:last], adjoint.mu)
                activate(trace.states[t, acted_on:, first:last], first, t, mask, policy, memory)
                u = trace.inputs[t, :, first:last]
                seen.enter_step(sensing, sensing_memory, adjoint)
                for k in range(moved - 1, -1, -1):
                    at, row = k * width_x, k * outputs
                    jacobian = trace.delta_jacobians[t, row : row + outputs, :, first:last]
                    state = trace.states[t, at : at + width_x, first:last]
                    frozen = trace.frozen[t, k, first:last]
                    seen.enter_row(sensing, k, gradient, sensing_memory, adjoint)
                    _through_changes(jacobian, frozen, model, adjoint)
                    _through_motion(
                        physics.drift, physics_memory.drift, model, state, u, frozen, adjoint
                    )
                    _through_features(
                        physics.features,
                        physics_memory.features,
                        state,
                        u,
                        jacobian,
                        frozen,
                        adjoint,
                    )
                    seen.leave_row(sensing, k, state, policy, sensing_memory, adjoint)
                commands = trace.commands[t, :, first:last]
                acted = trace.states[t, acted_on:, first:last]
                _through_brake(
                    policy.brake, memory.brake, acted, commands, sensing, sensing_memory, adjoint
                )
                jacobian = trace.input_jacobians[t, :, :, first:last]
                _through_policy(commands, jacobian, policy, memory.z, adjoint)
                seen.leave_step(sensing, t, policy, memory.z, sensing_memory, adjoint)
                add_product(memory.phi, adjoint.columns, moments)

    return backward


backward = _compiled(digest("search/fused"))
