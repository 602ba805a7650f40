"""The batched rollout as one differentiable operation of torch."""

from __future__ import annotations

import functools

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.dynamics import GPDynamics
from mcpilco.policies import Dropout, SumOfGaussians
from mcpilco.search.batched.masks import MaskBatch
from mcpilco.search.batched.model import ModelBatch
from mcpilco.search.batched.policy import PolicyBatch, parameter_gradients
from mcpilco.search.batched.sweeps import Trace, backward, forward
from mcpilco.search.particles import Particles


def rollout(
    dynamics: GPDynamics,
    policy: SumOfGaussians,
    start: Float[Tensor, "P X"],
    noise: Float[Tensor, "T P E"],
    dropout: Dropout | None = None,
    single: bool = False,
) -> Particles:
    """The particles' trajectories; equal to `mcpilco.search.particles.rollout`, gradients included.

    Args:
        dynamics: the model.
        policy: the policy.
        start: states at time 0.
        noise: standard normal numbers.
        dropout: mask of the policy's bases; None keeps them all.
        single: compute in float32; states and inputs are float64 all the same.
    """
    dtype = torch.float32 if single else torch.float64
    masks = MaskBatch.of([dropout], len(noise))
    policies, models = PolicyBatch.of([policy]), _alone(dynamics, dtype)
    states, inputs = rollout_batch(models, policies, start[None], noise[None], masks)
    return Particles(states[0].double(), inputs[0].double())


@functools.lru_cache(maxsize=4)
def _alone(dynamics: GPDynamics, dtype: torch.dtype) -> ModelBatch:
    return ModelBatch.of([dynamics]).to(torch.device("cpu"), dtype)


def rollout_batch(
    models: ModelBatch,
    policies: PolicyBatch,
    start: Float[Tensor, "S P X"],
    noise: Float[Tensor, "S T P E"],
    masks: MaskBatch | None = None,
) -> tuple[Float[Tensor, "S T_plus_1 P X"], Float[Tensor, "S T P U"]]:
    """States and inputs of the particles of S seeds, in the precision of the models.

    Args:
        models: of each seed, on the device that all else is on.
        policies: of each seed; gradients flow to their parameters, in the precision of these.
        start: states at time 0.
        noise: standard normal numbers.
        masks: dropout of the policies' bases; None keeps them all.
    """
    return _Rollout.apply(models, policies, masks, start, noise, *policies.parameters)


class _Rollout(torch.autograd.Function):
    """(parameters) -> (states, inputs)."""

    @staticmethod
    def forward(ctx, models, policies, masks, start, noise, *parameters):
        dtype, device = models.L_inv.dtype, models.L_inv.device
        policies = policies.to(device, dtype)
        start = start.to(dtype)
        steps = forward(models, policies.arrays(), start, noise.to(dtype), masks)
        if not any(ctx.needs_input_grad):
            states, inputs = zip(*(step[:2] for step in steps), strict=True)
            return torch.stack([start, *states], 1), torch.stack(inputs, 1)
        trace = Trace.of(start, steps)
        ctx.arrays = models, policies, trace
        ctx.dtype = parameters[0].dtype
        # detached: an output that its own node keeps alive would never be freed by itself
        return trace.states.detach(), trace.inputs.detach()

    @staticmethod
    def backward(ctx, state_gradients, input_gradients):
        models, policies, trace = ctx.arrays
        moments = backward(trace, models, policies.frame, state_gradients, input_gradients)
        gradients = parameter_gradients(policies, moments)
        return *[None] * 5, *(gradient.to(ctx.dtype) for gradient in gradients)
