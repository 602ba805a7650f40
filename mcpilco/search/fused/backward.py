"""The backward sweep, compiled: from d cost / d states to what the policy's gradient needs."""

from __future__ import annotations

from numba import njit

from mcpilco.compiling import digest
from mcpilco.search.fused.arithmetic import ONCE, OUTERMOST, PLAIN
from mcpilco.search.fused.foresight import through_foresight
from mcpilco.search.fused.observer import clear, through_estimate
from mcpilco.search.fused.policy import activate, augment
from mcpilco.search.fused.program import clear_adjoints, load, prepare, run, run_back
from mcpilco.search.fused.tiles import add_product


@njit(**PLAIN)
def _copy(source, out):
    # an assignment to a slice would say the same, and take a second longer to compile
    for i in range(out.shape[0]):
        for p in range(out.shape[1]):
            out[i, p] = source[i, p]


@njit(**PLAIN)
def _add(more, out):
    for i in range(out.shape[0]):
        for p in range(out.shape[1]):
            out[i, p] += more[i, p]


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
    for j in range(current.shape[0]):
        for p in range(current.shape[1]):
            current[j, p] += memory.adjoints[j, p]
    for j in range(mu.shape[0]):
        for p in range(mu.shape[1]):
            mu[j, p] += memory.adjoints[current.shape[0] + j, p]


@njit(**ONCE)
def _through_drift(state, inputs, frozen, drift, memory, adjoint):
    """From the next state to the state and the inputs of a program, which are added to."""
    following, current = adjoint.following, adjoint.current
    clear_adjoints(memory)
    for i in range(drift.outputs.size):
        result = memory.adjoints[drift.outputs[i]]
        for p in range(frozen.size):
            result[p] += 0.0 if frozen[p] else following[i, p]
            current[i, p] += following[i, p] if frozen[p] else 0.0
    _through_program(state, inputs, drift, memory, adjoint)


@njit(**ONCE)
def _through_features(state, inputs, jacobian, frozen, features, memory, adjoint):
    """From the changes through the further regressors to the state and the inputs."""
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


@njit(**PLAIN)
def _through_augmentation(policy, values, z, current):
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


def _compiled(sources: str):
    @njit(**OUTERMOST)
    def backward(
        start,
        stop,
        gradient_states,
        gradient_inputs,
        mask,
        policy,
        model,
        drift,
        features,
        weights,
        remembered,
        observer,
        foresight,
        trace,
        memory,
        adjoint,
        drift_memory,
        features_memory,
        observer_memory,
        foresight_memory,
        moments,
    ):
        """Adjoints of particles, last step first; adds up the policy's moments.

        With lambda the total derivative with respect to a state, and mu that with respect to an
        input:

            lambda_t = dc/dx_t + A^T lambda_{t+1}
                       + (dz/dx)^T (J_z^T B^T lambda_{t+1} + (du/dz)^T mu_t)
            mu_t     = dc/du_t + J_u^T B^T lambda_{t+1}

        Where the policy acts on estimates, (du/dz)^T mu_t goes through them instead: to the states
        that were measured, and to the estimates of the step before. With foresight it goes to what
        is expected of the states, which then has a lambda of its own.

        The activations are computed anew, which takes less time than to store them.

        Particles are those from start to stop, in blocks as wide as the memory. Shapes:
        gradient_states (T + 1, X, P), gradient_inputs (T, U, P), moments (B padded, U (1 + 2 Z)
        padded): sum_tp phi_tpb da_tpu [1, z, z^2].
        """
        sources  # noqa: B018
        outputs, width_x, width = model.B.shape[1], model.A.shape[0], memory.slope.size
        moved = trace.frozen.shape[1]
        for first in range(start, stop, width):
            last = first + width
            _copy(gradient_states[len(gradient_inputs), :, first:last], adjoint.current)
            if observer is not None:
                clear(observer_memory.expected)
            if foresight is not None:
                clear(foresight_memory.current)
            if drift is not None:
                prepare(drift, first, drift_memory)
            if features is not None:
                prepare(features, first, features_memory)
            for t in range(len(gradient_inputs) - 1, -1, -1):
                _copy(adjoint.current, adjoint.following)
                _copy(gradient_states[t, :, first:last], adjoint.current)
                _copy(gradient_inputs[t, :, first:last], adjoint.mu)
                activate(trace.seen[t, :, first:last], first, t, mask, policy, memory)
                u = trace.inputs[t, :, first:last]
                if foresight is not None:
                    _copy(foresight_memory.current, foresight_memory.following)
                    _copy(adjoint.following, foresight_memory.following[:width_x])
                    clear(foresight_memory.current)
                for k in range(moved - 1, -1, -1):
                    at, to, row = k * width_x, (k + 1) * width_x if k > 0 else 0, k * outputs
                    if foresight is not None:
                        _copy(foresight_memory.following[to : to + width_x], adjoint.following)
                        clear(adjoint.current)
                    jacobian = trace.delta_jacobians[t, row : row + outputs, :, first:last]
                    state = trace.states[t, at : at + width_x, first:last]
                    frozen = trace.frozen[t, k, first:last]
                    _through_changes(jacobian, frozen, model, adjoint)
                    if drift is not None:
                        _through_drift(state, u, frozen, drift, drift_memory, adjoint)
                    else:
                        _through_flow(frozen, model, adjoint)
                        if remembered is not None:
                            _through_memory(frozen, remembered, adjoint)
                    if features is not None:
                        _through_features(
                            state, u, jacobian, frozen, features, features_memory, adjoint
                        )
                    if foresight is not None:
                        augment(state, policy, foresight_memory.z)
                        z, current = adjoint.z, adjoint.current
                        _through_augmentation(policy, foresight_memory.z, z, current)
                        _copy(current, foresight_memory.current[at : at + width_x])
                if foresight is not None:
                    _add(gradient_states[t, :, first:last], adjoint.current)
                    clear(adjoint.z)
                if observer is not None:
                    augment(trace.states[t, :, first:last], policy, observer_memory.z)
                    z, current = adjoint.z, adjoint.current
                    _through_augmentation(policy, observer_memory.z, z, current)
                    clear(z)
                inputs, jacobian = trace.inputs[t], trace.input_jacobians[t]
                inputs, jacobian = inputs[:, first:last], jacobian[:, :, first:last]
                _through_policy(inputs, jacobian, policy, memory.z, adjoint)
                if observer is not None:
                    clear(observer_memory.estimates)
                    _through_augmentation(policy, memory.z, adjoint.z, observer_memory.estimates)
                    through_estimate(observer, t, observer_memory, adjoint.current)
                elif foresight is not None:
                    rows = foresight_memory.current
                    told = rows[rows.shape[0] - width_x :]
                    _through_augmentation(policy, memory.z, adjoint.z, told)
                    through_foresight(rows, adjoint.current)
                else:
                    _through_augmentation(policy, memory.z, adjoint.z, adjoint.current)
                add_product(memory.phi, adjoint.columns, moments)

    return backward


backward = _compiled(digest("search/fused"))
