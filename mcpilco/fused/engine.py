"""The compiled rollout as one differentiable operation of torch."""

from __future__ import annotations

import functools

import numpy as np
import torch
from jaxtyping import Float
from threadpoolctl import ThreadpoolController
from torch import Tensor

from mcpilco.dropout import Dropout
from mcpilco.dynamics import GPDynamics
from mcpilco.fused import layout
from mcpilco.fused.backward import backward, moments
from mcpilco.fused.forward import forward
from mcpilco.kernels.base import NoCanonicalFormError
from mcpilco.policies import SumOfGaussians
from mcpilco.rollout import Particles
from mcpilco.typing import Dynamics, Policy


def supports(dynamics: Dynamics, policy: Policy) -> bool:
    """Whether the compiled loops know this model and policy; `mcpilco.rollout` knows them all."""
    if not (type(dynamics) is GPDynamics and type(policy) is SumOfGaussians):
        return False
    try:
        dynamics.posterior.kernel.terms()
    except NoCanonicalFormError:
        return False
    return True


def rollout(
    dynamics: GPDynamics,
    policy: SumOfGaussians,
    start: Float[Tensor, "P X"],
    noise: Float[Tensor, "T P E"],
    dropout: Dropout | None = None,
) -> Particles:
    """The particles' trajectories; equal to `mcpilco.rollout.rollout`, gradients included."""
    learned = policy.centres, policy.log_lengthscale, policy.weights
    return Particles(*_Rollout.apply(dynamics, policy, dropout, start, noise, *learned))


class _Shelf:
    """Large arrays that one step hands on to the next: fresh memory costs more than filling it."""

    MOST_SHAPES = 16

    def __init__(self) -> None:
        self._free: dict[tuple[int, ...], list[np.ndarray]] = {}

    def take(self, *shape: int) -> np.ndarray:
        free = self._free.get(shape)
        return free.pop() if free else np.empty(shape)

    def give_back(self, *arrays: np.ndarray) -> None:
        if len(self._free) > self.MOST_SHAPES:
            self._free.clear()
        for array in arrays:
            self._free.setdefault(array.shape, []).append(array)


_shelf = _Shelf()
_model_arrays = functools.lru_cache(maxsize=2)(layout.model_arrays)


@functools.lru_cache(maxsize=1)
def _blas() -> ThreadpoolController:
    """The BLAS libraries that are loaded; the compiled loops use scipy's, on one thread."""
    return ThreadpoolController()


def _mask(dropout: Dropout | None, steps: int) -> layout.Mask:
    if dropout is None:
        return layout.Mask(np.zeros(steps, dtype=np.uint32), 0, 1.0)
    return layout.Mask(dropout.keys(steps), dropout.threshold, dropout.scale)


class _Rollout(torch.autograd.Function):
    """(policy parameters) -> (states, inputs)."""

    @staticmethod
    def forward(ctx, dynamics, policy, dropout, start, noise, centres, log_lengthscale, weights):
        model, controller = _model_arrays(dynamics), layout.policy_arrays(policy)
        steps, particles, outputs = noise.shape
        bases, count = weights.shape
        z_width = centres.shape[1]
        trace = layout.Trace(
            states=np.empty((steps + 1, *start.shape)),
            inputs=np.empty((steps, particles, count)),
            activations=_shelf.take(steps, particles, layout.padded(bases)),
            delta_jacobians=_shelf.take(steps, particles, outputs, z_width + count),
            input_jacobians=_shelf.take(steps, particles, count, z_width),
            frozen=np.empty((steps, particles), dtype=np.uint8),
        )
        trace.states[0] = start.numpy()
        memory = layout.make_memory(model, controller)
        with _blas().limit(limits=1):
            forward(trace, noise.numpy(), _mask(dropout, steps), controller, model, memory)
        if not any(ctx.needs_input_grad):
            _shelf.give_back(trace.activations, trace.delta_jacobians, trace.input_jacobians)
        ctx.arrays = model, controller, trace
        ctx.save_for_backward(centres, log_lengthscale, weights)
        return torch.from_numpy(trace.states), torch.from_numpy(trace.inputs)

    @staticmethod
    def backward(ctx, gradient_states, gradient_inputs):
        model, controller, trace = ctx.arrays
        steps, particles, count, z_width = trace.input_jacobians.shape
        columns = _shelf.take(steps, particles, count, 1 + 2 * z_width)
        scratch = np.empty((3, trace.states.shape[2] + z_width + count + model.B.shape[1]))
        gradients = (np.ascontiguousarray(g.numpy()) for g in (gradient_states, gradient_inputs))
        backward(*gradients, columns, trace, controller, model, scratch)
        rows = steps * particles
        with _blas().limit(limits=1):
            sums = moments(trace.activations.reshape(rows, -1), columns.reshape(rows, -1))
        _shelf.give_back(trace.activations, columns)
        _shelf.give_back(trace.delta_jacobians, trace.input_jacobians)
        centres, log_lengthscale, weights = ctx.saved_tensors
        sums = torch.from_numpy(sums)[: len(weights)].unflatten(1, (count, -1))
        return *[None] * 5, *_policy_gradients(centres, log_lengthscale, weights, sums)


def _policy_gradients(
    centres: Float[Tensor, "B Z"],
    log_lengthscale: Float[Tensor, " Z"],
    weights: Float[Tensor, "B U"],
    moments: Float[Tensor, "B U one_plus_two_Z"],
) -> tuple[Tensor, Tensor, Tensor]:
    """Gradients of centres, log-lengthscales and weights, from the moments sum phi da [1, z, z^2].

    dphi_b/dc_bd = 2 phi_b (z_d - c_bd) / l_d^2,   dphi_b/dlog l_d = 2 phi_b (z_d - c_bd)^2 / l_d^2
    """
    z_width = centres.shape[1]
    weighted = (weights[:, :, None] * moments).sum(1)
    mass, first, second = weighted.split([1, z_width, z_width], -1)
    factor = 2 * torch.exp(-2 * log_lengthscale)
    gradient_centres = factor * (first - centres * mass)
    gradient_scales = factor * (second - 2 * centres * first + centres**2 * mass).sum(0)
    return gradient_centres, gradient_scales, moments[:, :, 0]
