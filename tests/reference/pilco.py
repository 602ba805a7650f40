"""PILCO's prediction step by step in plain torch, whose gradient torch finds.

`baselines.pilco.rollout` computes the same numbers in compiled loops with a gradient of its own.
"""

from __future__ import annotations

import torch

from baselines.moments import Gaussian, through_bases, through_squash, through_trig
from baselines.pilco.rollout import GaussianDynamics, GPMean


def predicted(
    dynamics: GaussianDynamics, policy: GPMean, start: Gaussian, horizon: int
) -> tuple[Gaussian, Gaussian]:
    """The states at times 0 to T and the inputs between; arguments as of the compiled one."""
    steps, inputs = [start], []
    for _ in range(horizon):
        state, used = step(dynamics, policy, steps[-1])
        steps.append(state)
        inputs.append(used)
    return stacked(steps), stacked(inputs)


def step(dynamics: GaussianDynamics, policy: GPMean, state: Gaussian) -> tuple[Gaussian, Gaussian]:
    """The next state, and the input that led to it."""
    (joint, z), U = augmented(dynamics, state), len(policy.squash.centre)
    a = range(joint.width, joint.width + U)
    joint = joint.joined(z, through_bases(policy.bases(), *joint.part(z)))
    u = range(joint.width, joint.width + U)
    joint = joint.joined(a, through_squash(*joint.part(a), policy.squash.half_range))
    joint = Gaussian(joint.mean.index_add(-1, torch.tensor(u), policy.squash.centre), joint.cov)
    zu, X = [*z, *u], len(dynamics.A)
    following = joint.joined(zu, through_bases(dynamics.bases, *joint.part(zu)))
    between = dynamics.A.new_zeros(X, joint.width - X)
    law = torch.cat([dynamics.A, between, dynamics.B], 1)
    return following.mapped(law), Gaussian(*joint.part(u))


def augmented(dynamics: GaussianDynamics, state: Gaussian) -> tuple[Gaussian, list[int]]:
    """The state with the sines and cosines of its angles behind it, and which entries are z."""
    X, z = len(dynamics.A), list(dynamics.augmentation.plain)
    angles = dynamics.augmentation.angles
    if not angles:
        return state, z
    sines = range(X, X + 2 * len(angles), 2)
    joint = state.joined(range(X), through_trig(*state.part(range(X)), angles))
    return joint, [*z, *(i + 1 for i in sines), *sines]


def stacked(steps: list[Gaussian]) -> Gaussian:
    """Gaussians of equal width, one behind the other along a new first axis."""
    return Gaussian(torch.stack([s.mean for s in steps]), torch.stack([s.cov for s in steps]))
