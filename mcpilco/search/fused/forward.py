"""The forward sweep, compiled: states, inputs, and the local Jacobians for the backward sweep.

With the local Jacobians at hand the backward sweep is nearly free, and nothing of size P x N
outlives its block of particles.
"""

from __future__ import annotations

from numba import njit

from mcpilco.compiling import digest
from mcpilco.search.fused.arithmetic import ONCE, OUTERMOST
from mcpilco.search.fused.foresight import foresee
from mcpilco.search.fused.observer import estimate, expect_start
from mcpilco.search.fused.policy import act, activate, augment
from mcpilco.search.fused.posterior import change
from mcpilco.search.fused.program import load, prepare, run


@njit(**ONCE)
def _regress(inputs, z, ones, x):
    """The rows z and u of x, and the one of ones."""
    for d in range(z.shape[0]):
        for p in range(z.shape[1]):
            x[d, p] = z[d, p]
    for i in range(inputs.shape[0]):
        row = x[z.shape[0] + i]
        for p in range(z.shape[1]):
            row[p] = inputs[i, p]
    for p in range(z.shape[1]):
        x[ones, p] = 1.0


@njit(**ONCE)
def _regress_features(features, memory, state, inputs, end, x):
    """The rows of the further regressors, which end before `end`."""
    load(features, state, inputs, memory)
    run(features, memory)
    for i in range(features.outputs.size):
        row, value = x[end - features.outputs.size + i], memory.registers[features.outputs[i]]
        for p in range(value.size):
            row[p] = value[p]


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
    """Adds C u of a block: what is remembered of the inputs."""
    for i in range(memory.shape[0]):
        for j in range(memory.shape[1]):
            for p in range(inputs.shape[1]):
                following[i, p] += memory[i, j] * inputs[j, p]


@njit(**ONCE)
def _drift(drift, memory, state, inputs, following):
    """The next states of a block by the program."""
    load(drift, state, inputs, memory)
    run(drift, memory)
    for i in range(drift.outputs.size):
        value = memory.registers[drift.outputs[i]]
        for p in range(value.size):
            following[i, p] = value[p]


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
    def forward(
        start,
        stop,
        noise,
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
        policy_memory,
        model_memory,
        drift_memory,
        features_memory,
        observer_memory,
        foresight_memory,
    ):
        """Roll particles out, block by block, and fill the trace behind its first states.

        Particles are those from start to stop, in blocks as wide as the memory. With foresight
        what is expected of them moves behind them, as they do; noise: (T, K E, P), zeros for it.
        """
        sources  # noqa: B018  closed over, so that a change in any of them compiles this anew
        steps, moved, _ = trace.frozen.shape
        outputs, width_x, width = model.B.shape[1], model.A.shape[0], policy_memory.slope.size
        for first in range(start, stop, width):
            last = first + width
            if observer is not None:
                expect_start(observer, observer_memory)
            if drift is not None:
                prepare(drift, first, drift_memory)
            if features is not None:
                prepare(features, first, features_memory)
            for t in range(steps):
                now, inputs = trace.states[t, :, first:last], trace.inputs[t, :, first:last]
                seen = trace.seen[t, :, first:last]
                if observer is not None:
                    errors = observer.errors[t, :, first:last]
                    estimate(observer, t, errors, now, observer_memory, seen)
                if foresight is not None:
                    foresee(foresight.errors[t, :, first:last], now, seen)
                activate(seen, first, t, mask, policy, policy_memory)
                act(policy, policy_memory, inputs, trace.input_jacobians[t, :, :, first:last])
                for k in range(moved):
                    at, to = k * width_x, (k + 1) * width_x if k > 0 else 0
                    state = trace.states[t, at : at + width_x, first:last]
                    following = trace.states[t + 1, to : to + width_x, first:last]
                    x, ones = model_memory.x, model.middle.size
                    if observer is not None:
                        augment(state, policy, observer_memory.z)
                        _regress(inputs, observer_memory.z, ones, x)
                    elif foresight is not None:
                        augment(state, policy, foresight_memory.z)
                        _regress(inputs, foresight_memory.z, ones, x)
                    else:
                        _regress(inputs, policy_memory.z, ones, x)
                    if features is not None:
                        _regress_features(features, features_memory, state, inputs, ones, x)
                    for e in range(outputs):
                        jacobian = trace.delta_jacobians[t, k * outputs + e, :, first:last]
                        eps, own = noise[t, k * outputs + e, first:last], weights[e, :, first:last]
                        change(e, eps, own, model, model_memory, jacobian)
                    if drift is not None:
                        _drift(drift, drift_memory, state, inputs, following)
                    else:
                        _flow(model, state, following)
                        if remembered is not None:
                            _remember(remembered, inputs, following)
                    frozen = trace.frozen[t, k, first:last]
                    _advance(model, model_memory.delta, state, following, frozen)

    return forward


forward = _compiled(digest("search/fused"))
