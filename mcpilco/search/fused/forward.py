"""The forward sweep, compiled: states, inputs, and the local Jacobians for the backward sweep.

With the local Jacobians at hand the backward sweep is nearly free, and nothing of size P x N
outlives its block of particles.
"""

from __future__ import annotations

from numba import njit

from mcpilco.compiling import digest
from mcpilco.search.fused import sensing as seen
from mcpilco.search.fused.arithmetic import ONCE, OUTERMOST, PLAIN
from mcpilco.search.fused.policy import act, activate
from mcpilco.search.fused.posterior import change
from mcpilco.search.fused.program import evaluate, prepare


@njit(**ONCE)
def _regress(inputs, at, ones, x):
    """The rows of the inputs in x, behind the augmented states, and the one of ones."""
    for i in range(inputs.shape[0]):
        row = x[at + i]
        for p in range(row.size):
            row[p] = inputs[i, p]
    for p in range(x.shape[1]):
        x[ones, p] = 1.0


@njit(**PLAIN)
def _regress_features(features, memory, state, inputs, end, x):
    """The rows of the further regressors, if any, which end before `end`."""
    if features is None:
        return
    evaluate(features, memory, state, inputs, x[end - features.outputs.size : end])


@njit(**ONCE)
def _flow(model, state, following):
    """A x of a block."""
    A = model.A
    for i in range(A.shape[0]):
        for p in range(state.shape[1]):
            following[i, p] = 0.0
        for j in range(A.shape[1]):
            for p in range(state.shape[1]):
                following[i, p] += A[i, j] * state[j, p]


@njit(**ONCE)
def _remember(memory, inputs, following):
    """Adds C u of a block: the past inputs that its next states hold."""
    for i in range(memory.shape[0]):
        for j in range(memory.shape[1]):
            for p in range(inputs.shape[1]):
                following[i, p] += memory[i, j] * inputs[j, p]


@njit(**PLAIN)
def _move(drift, memory, model, state, inputs, following):
    """The next states of a block without the GPs' changes: A x + C u, or by a program."""
    if drift is None:
        _flow(model, state, following)
        _remember(model.C, inputs, following)
        return
    evaluate(drift, memory, state, inputs, following)


@njit(**ONCE)
def _advance(model, delta, state, following, frozen):
    """Adds B delta to a block, which becomes x where that is implausible; frozen tells which."""
    A, B, predicted, bounds = model.A, model.B, model.predicted, model.bounds
    for i in range(A.shape[0]):
        for e in range(B.shape[1]):
            for p in range(frozen.size):
                following[i, p] += B[i, e] * delta[e, p]
    for p in range(frozen.size):
        frozen[p] = 0
    for e in range(predicted.size):
        for p in range(frozen.size):
            frozen[p] |= not abs(following[predicted[e], p]) <= bounds[e]
    for i in range(A.shape[0]):
        for p in range(frozen.size):
            following[i, p] = state[i, p] if frozen[p] else following[i, p]


def _compiled(sources: str):
    @njit(**OUTERMOST)
    def forward(start, stop, noise, arrays, memory):
        """Roll particles out, block by block, and fill the trace behind its first states.

        Particles are those from start to stop, in blocks as wide as the memory. `arrays` are of
        mask, policy, model, physics, sensing and trace, `memory` of policy, model, physics and
        sensing. Where a policy acts on estimates, further rows of a particle move as its state
        does, see `mcpilco.search.fused.sensing`; noise: (T, K E, P), zeros for these.
        """
        sources  # noqa: B018  closed over, so that a change in any of them compiles this anew
        mask, policy, model, physics, sensing, trace = arrays
        policy_memory, model_memory, physics_memory, sensing_memory = memory
        steps, moved, _ = trace.frozen.shape
        outputs, width_x, width = model.B.shape[1], model.A.shape[0], policy_memory.slope.size
        acted_on = trace.states.shape[1] - width_x
        for first in range(start, stop, width):
            last = first + width
            seen.begin(sensing, sensing_memory)
            prepare(policy.brake, first, policy_memory.brake)
            prepare(physics.drift, first, physics_memory.drift)
            prepare(physics.features, first, physics_memory.features)
            for t in range(steps):
                now, inputs = trace.states[t, :, first:last], trace.inputs[t, :, first:last]
                seen.observe(sensing, t, first, now, width_x, sensing_memory)
                activate(now[acted_on:], first, t, mask, policy, policy_memory)
                jacobian = trace.input_jacobians[t, :, :, first:last]
                commands = trace.commands[t, :, first:last]
                act(policy, policy_memory, commands, jacobian)
                evaluate(policy.brake, policy_memory.brake, now[acted_on:], commands, inputs)
                for k in range(moved):
                    at, to = k * width_x, (k + 1) * width_x if k > 0 else 0
                    state = trace.states[t, at : at + width_x, first:last]
                    following = trace.states[t + 1, to : to + width_x, first:last]
                    x, ones = model_memory.x, model.middle.size
                    seen.set_augmented(sensing, state, policy, policy_memory.z, x)
                    _regress(inputs, policy_memory.z.shape[0], ones, x)
                    _regress_features(
                        physics.features, physics_memory.features, state, inputs, ones, x
                    )
                    for e in range(outputs):
                        jacobian = trace.delta_jacobians[t, k * outputs + e, :, first:last]
                        eps = noise[t, k * outputs + e, first:last]
                        own = physics.weights[e, :, first:last]
                        change(e, eps, own, model, model_memory, jacobian)
                    _move(physics.drift, physics_memory.drift, model, state, inputs, following)
                    frozen = trace.frozen[t, k, first:last]
                    _advance(model, model_memory.delta, state, following, frozen)

    return forward


forward = _compiled(digest("search/fused"))
