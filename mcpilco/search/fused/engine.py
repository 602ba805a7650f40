"""The compiled rollout as one differentiable operation of torch, and what it can roll out."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from operator import mul
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.dynamics import GPDynamics, PhysicsDraw, PhysicsDynamics
from mcpilco.kernels import NoCanonicalFormError
from mcpilco.plant import Program, Real, cos, features_of, sin
from mcpilco.policies import Dropout, SumOfGaussians
from mcpilco.search.fused import layout
from mcpilco.search.fused.backward import backward
from mcpilco.search.fused.forward import forward
from mcpilco.search.fused.policy import differentiate, prepare
from mcpilco.search.fused.sensing import parts, sensing_arrays, sensing_memory
from mcpilco.search.particles import Particles, Sensing
from mcpilco.sensing import Observer
from mcpilco.typing import Dynamics, Policy, UncertainDynamics


def unknown(
    dynamics: Dynamics | UncertainDynamics, policy: Policy, observer: Observer | None = None
) -> str | None:
    """Name what of these the compiled loops cannot roll out; None where they know all.

    They know a GP whose kernel is a sum of canonical terms, with physics as its mean or without,
    a sum of Gaussians that sees the state as the GP does, and linear estimators and delay models.
    """
    model = dynamics.model if isinstance(dynamics, PhysicsDynamics | PhysicsDraw) else dynamics
    if type(model) is not GPDynamics:
        return f"the model {type(model).__name__} (they know GPDynamics, sampled step by step)"
    if type(policy) is not SumOfGaussians:
        return f"the policy {type(policy).__name__} (they know SumOfGaussians)"
    seen, acted = model.augmentation, policy.augmentation
    if (seen.state_dim, seen.angles) != (acted.state_dim, acted.angles):
        return "a policy that sees other states or angles than the model"
    if observer is not None and parts(observer) is None:
        name = type(observer.estimator).__name__
        return f"the estimator {name} (they know LinearEstimator, DelayModel and a Chain of both)"
    try:
        model.posterior.kernel.canonical()
    except NoCanonicalFormError as error:
        return f"the kernel ({' '.join(str(error).split())})"
    return None


def is_on_disk() -> bool:
    """Whether numba has kept the forward sweep since the last change of these files."""
    kept = Path(str(forward.stats.cache_path)).glob("forward*.nbi")
    written = [path.stat().st_mtime for path in kept]
    sources = [path.stat().st_mtime for path in Path(__file__).parent.glob("*.py")]
    return max(written, default=0.0) >= max(sources)


def skip(loop: Literal["forward", "backward"]) -> None:
    """Let one of the compiled loops do nothing in this process; states and slopes are 0 then."""
    nothing = {"forward": _stay, "backward": lambda *arguments: None}
    globals()[loop] = nothing[loop]


def _stay(start: int, stop: int, noise: np.ndarray, arrays: tuple, memory: tuple) -> None:
    for array in arrays[-1]:  # of the trace
        array.fill(0)


def canonical_features(dynamics: GPDynamics) -> Program | None:
    """The further regressors that a model's canonical terms see behind [z, u].

    These are its features, and linear combinations of all; None where there are none.
    """
    W = dynamics.posterior.kernel.canonical().W
    if not W.shape[1]:
        return dynamics.features
    seen = dynamics.augmentation

    def rows(given: Sequence[Real]) -> list[Any]:
        angles = [given[i] for i in seen.angles]
        z = [*(given[i] for i in seen.plain), *map(cos, angles), *map(sin, angles)]
        further = [] if dynamics.features is None else dynamics.features.on_tape(given)
        x = [*z, *given[seen.state_dim :], *further]
        return further + [sum(map(mul, column, x)) for column in W.T.tolist()]

    return features_of(seen.state_dim + dynamics.C.shape[1], [rows])[0]


def rollout(
    dynamics: GPDynamics | PhysicsDraw,
    policy: SumOfGaussians,
    start: Float[Tensor, "P X"],
    noise: Float[Tensor, "T P E"],
    dropout: Dropout | None = None,
    sensing: Sensing | None = None,
    single: bool = False,
) -> Particles:
    """The particles' trajectories; equal to `mcpilco.search.particles.rollout`, gradients included.

    With `single` it computes in float32; states, inputs and gradients are float64 all the same.
    """
    dtype = np.float32 if single else np.float64
    learned = policy.centres, policy.log_lengthscale, policy.weights
    arguments = dynamics, policy, dropout, sensing, dtype, start, noise
    return Particles(*_Rollout.apply(*arguments, *learned))


_model_arrays = functools.lru_cache(maxsize=4)(layout.model_arrays)
_features = functools.lru_cache(maxsize=4)(canonical_features)


def _physics(
    dynamics: GPDynamics | PhysicsDraw, dtype: np.dtype, padded: int
) -> layout.PhysicsArrays:
    """The arrays of a model's physics, for particles that are padded with copies of the first."""
    model = dynamics.model if isinstance(dynamics, PhysicsDraw) else dynamics
    program = _features(model)
    features = None if program is None else layout.program_arrays(program, None, dtype)
    if not isinstance(dynamics, PhysicsDraw):
        none: np.ndarray = np.zeros((len(model.predicted), 0, padded), dtype)
        return layout.PhysicsArrays(None, features, none)
    numbers, weights = (_padded(a.numpy(), padded) for a in (dynamics.numbers.mT, dynamics.weights))
    drift = layout.program_arrays(dynamics.program, numbers, dtype)
    return layout.PhysicsArrays(drift, features, np.ascontiguousarray(weights, dtype))


def _padded(array: np.ndarray, padded: int) -> np.ndarray:
    """The array with its first particle repeated behind the last."""
    missing = np.repeat(array[..., :1], padded - array.shape[-1], axis=-1)
    return np.concatenate([array, missing], axis=-1)


def _mask(dropout: Dropout | None, steps: int, dtype: type[np.floating]) -> layout.Mask:
    if dropout is None:
        return layout.Mask(np.zeros(steps, dtype=np.uint32), 0, np.ones(1, dtype=dtype))
    scale = np.array([dropout.scale], dtype=dtype)
    return layout.Mask(dropout.keys(steps), dropout.threshold, scale)


def _particles_last(
    array: Float[Tensor, "*b P C"], padded: int, dtype: type, rows: int | None = None
) -> np.ndarray:
    """(*b, rows, padded) of (*b, P, C), zeros behind the last particle and behind C rows."""
    *batch, particles, components = array.shape
    out: np.ndarray = np.zeros((*batch, rows or components, padded), dtype=dtype)
    out[..., :components, :particles] = array.mT.numpy()
    return out


class _Rollout(torch.autograd.Function):
    """(policy parameters) -> (states, inputs)."""

    @staticmethod
    def forward(
        ctx, dynamics, policy, dropout, sensing, dtype, start, noise, centres, log_scale, weights
    ):
        known = dynamics.model if isinstance(dynamics, PhysicsDraw) else dynamics
        model, controller = _model_arrays(known, dtype), layout.policy_arrays(policy, dtype)
        prepare(centres.numpy(), log_scale.numpy(), weights.numpy(), controller)
        steps, particles, outputs = noise.shape
        _, count = weights.shape
        z_width = centres.shape[1]
        padded = layout.padded(particles, dtype)
        seen, ahead = None, -1
        if sensing is not None:
            seen = sensing_arrays(sensing.observer, _particles_last(sensing.noise, padded, dtype))
            ahead = seen.ahead
        physics = _physics(dynamics, dtype, padded)
        regressors = len(model.middle)
        rows, moved, width_x = ahead + 2, max(ahead, 0) + 1, start.shape[1]
        commands = np.empty((steps, count, padded), dtype)
        trace = layout.Trace(
            states=np.empty((steps + 1, rows * width_x, padded), dtype),
            commands=commands,
            inputs=commands if controller.brake is None else np.empty_like(commands),
            delta_jacobians=np.empty((steps, moved * outputs, regressors, padded), dtype),
            input_jacobians=np.empty((steps, count, z_width, padded), dtype),
            frozen=np.empty((steps, moved, padded), dtype=np.uint8),
        )
        trace.states[0] = np.tile(_particles_last(start, padded, dtype), (rows, 1))
        noise = _particles_last(noise, padded, dtype, moved * outputs)
        ctx.arrays = _mask(dropout, steps, dtype), controller, model, physics, seen, trace
        for first, last, width in layout.blocks(particles, layout.FORWARD_STRIPS, dtype):
            memory = (
                layout.policy_memory(controller, width),
                layout.model_memory(model, width),
                layout.physics_memory(physics, width),
                sensing_memory(seen, width_x, z_width, width),
            )
            forward(first, last, noise, ctx.arrays, memory)
        ctx.particles = particles
        ctx.save_for_backward(centres, log_scale, weights)
        states, inputs = (
            torch.from_numpy(a[..., :particles].astype(np.float64, copy=dtype != np.float64)).mT
            for a in (trace.states[:, :width_x], trace.inputs)
        )
        return states, inputs

    @staticmethod
    def backward(ctx, gradient_states, gradient_inputs):
        _, controller, model, physics, seen, trace = ctx.arrays
        dtype, padded = trace.states.dtype, trace.states.shape[-1]
        count, z_width = trace.input_jacobians.shape[1:3]
        columns = layout.padded(count * (1 + 2 * z_width), dtype)
        moments = np.zeros((layout.rows_of(controller.centres), columns), dtype)
        gradients = [_particles_last(g, padded, dtype) for g in (gradient_states, gradient_inputs)]
        for first, last, width in layout.blocks(ctx.particles, layout.BACKWARD_STRIPS, dtype):
            memories = (
                layout.policy_memory(controller, width),
                layout.adjoint_memory(model, controller, width),
                layout.physics_memory(physics, width),
                sensing_memory(seen, len(model.A), z_width, width),
            )
            backward(first, last, *gradients, ctx.arrays, memories, moments)
        learned = [parameter.numpy() for parameter in ctx.saved_tensors]
        slopes = [np.empty_like(parameter) for parameter in learned]
        differentiate(*learned, moments, *slopes)
        return *[None] * 7, *map(torch.from_numpy, slopes)
