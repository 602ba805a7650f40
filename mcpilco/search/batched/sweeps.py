"""The way forward, which forms the local Jacobians too, and the way back, which multiplies them.

The matrices of the way back have the size of a state: it is nearly free.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from mcpilco.search.batched.masks import MaskBatch
from mcpilco.search.batched.model import ModelBatch
from mcpilco.search.batched.policy import Frame, PolicyArrays
from mcpilco.search.batched.powers import powers


class Step(NamedTuple):
    """What one time step leaves behind."""

    states: Float[Tensor, "S P X"]
    """after the step"""
    inputs: Float[Tensor, "S P U"]
    activations: Float[Tensor, "S P B"]
    """dropout included"""
    delta_jacobians: Float[Tensor, "S P E D"]
    """d delta / d [z, u]"""
    input_jacobians: Float[Tensor, "S P U Z"]
    """du/dz"""
    frozen: Bool[Tensor, "S P"]
    """where the particle stayed"""


@dataclass(frozen=True)
class Trace:
    """All steps, with time as the second axis, and the start before the states."""

    states: Float[Tensor, "S T_plus_1 P X"]
    inputs: Float[Tensor, "S T P U"]
    activations: Float[Tensor, "S T P B"]
    delta_jacobians: Float[Tensor, "S T P E D"]
    input_jacobians: Float[Tensor, "S T P U Z"]
    frozen: Bool[Tensor, "S T P"]

    @classmethod
    def of(cls, start: Float[Tensor, "S P X"], steps: Iterable[Step]) -> Trace:
        """The steps as they come."""
        states, *others = zip(*steps, strict=True)
        return cls(*(torch.stack(part, 1) for part in ((start, *states), *others)))


def forward(
    model: ModelBatch,
    policy: PolicyArrays,
    start: Float[Tensor, "S P X"],
    noise: Float[Tensor, "S T P E"],
    masks: MaskBatch | None,
) -> Iterator[Step]:
    """All particles of all seeds, step by step.

    Reference: thesis section 5.4.1.
    """
    states, particles, bases = start, start.shape[1], policy.exponents.shape[-1]
    for t, normal in enumerate(noise.unbind(1)):
        z = policy.frame.augmented(states)
        phi = policy.activations(z)
        if masks is not None:
            phi *= masks.factors(t, particles, bases)
        inputs, input_jacobians = policy.inputs(z, phi)
        delta, delta_jacobians = model.change(torch.cat([z, inputs], -1), normal)
        states, frozen = model.follow(states, delta)
        yield Step(states, inputs, phi, delta_jacobians, input_jacobians, frozen)


def backward(
    trace: Trace,
    model: ModelBatch,
    frame: Frame,
    state_gradients: Float[Tensor, "S T_plus_1 P X"],
    input_gradients: Float[Tensor, "S T P U"],
) -> Float[Tensor, "S B U one_plus_two_Z"]:
    """The moments sum_tp phi da [1, z, z^2] that the policy's gradient is made of.

    With lambda the total derivative with respect to a state, and mu that with respect to an input:

        lambda_t = dc/dx_t + (du/dx)^T dc/du_t + (dx'/dx)^T lambda_{t+1}
        mu_t     = dc/du_t + (dx'/du)^T lambda_{t+1}

    All Jacobians are there, so that only the sum over lambda goes step by step.
    """
    before = trace.states[:, :-1]
    du_dx = frame.chained(trace.input_jacobians, before)
    dx_dx, dx_du = _closed_loop(trace, model, frame, du_dx)
    own = state_gradients.clone()
    own[:, :-1] += (input_gradients[..., None] * du_dx).sum(-2)
    for t in reversed(range(trace.inputs.shape[1])):
        own[:, t] += (own[:, t + 1, :, :, None] * dx_dx[:, t]).sum(-2)
    mu = input_gradients + (own[:, 1:, ..., None] * dx_du).sum(-2)
    da = mu * frame.squash_slope(trace.inputs)
    columns = da[..., None] * powers(frame.augmented(before))[..., None, :]
    moments = trace.activations.flatten(1, 2).mT @ columns.flatten(-2).flatten(1, 2)
    return moments.unflatten(-1, columns.shape[-2:])


def _closed_loop(
    trace: Trace, model: ModelBatch, frame: Frame, du_dx: Float[Tensor, "S T P U X"]
) -> tuple[Float[Tensor, "S T P X X"], Float[Tensor, "S T P X U"]]:
    """dx'/dx with the policy in the loop, and dx'/du; identity and zero where a particle stayed.

    Selected, not multiplied: the Jacobian of a particle that stayed need not be finite.
    """
    width = trace.input_jacobians.shape[-1]
    by_z, by_u = trace.delta_jacobians.split([width, len(frame.centre)], -1)
    by_x = frame.chained(by_z, trace.states[:, :-1]) + by_u @ du_dx
    stayed = trace.frozen[..., None, None]
    identity = torch.eye(len(model.A), dtype=by_x.dtype, device=by_x.device)
    dx_dx = torch.where(stayed, identity, model.A + model.B @ by_x)
    return dx_dx, torch.where(stayed, 0.0, model.B @ by_u)
