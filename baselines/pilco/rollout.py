"""The prediction of PILCO: one Gaussian over the state, from step to step, in closed form.

This is the algorithm as it reads; `baselines.pilco.compiled` computes the same numbers faster.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.moments.bases import Bases, through_bases
from baselines.moments.costs import expected_cost
from baselines.moments.image import Gaussian
from baselines.moments.sines import through_squash, through_trig
from baselines.pilco.policy import GPMean
from mcpilco.dynamics import AngleAugmentation
from mcpilco.typing import Cost


@dataclass(frozen=True)
class GaussianDynamics:
    """The step of a Gaussian state under a policy, by the posterior of the changes."""

    bases: Bases
    """of the E predicted changes, on regressors [z, u]"""
    augmentation: AngleAugmentation
    """from the state to z"""
    A: Float[Tensor, "X X"]
    """from the state to the next one"""
    B: Float[Tensor, "X E"]
    """from the predicted changes to the next state"""

    def step(self, state: Gaussian, policy: GPMean, argument: Bases) -> tuple[Gaussian, Gaussian]:
        """The next state, and the input that led to it.

        The uncertainty of the functions is predicted, not the noise of measurements.

        Args:
            state: now.
            policy: what acts.
            argument: its `bases`, made once for all steps.

        Reference: DFR on trajectory prediction.
        Differs: the law from changes to states is the model's, x' = A x + B delta.
        """
        (joint, z), U = self.augmented(state), len(policy.squash.centre)
        a = range(joint.width, joint.width + U)
        joint = joint.joined(z, through_bases(argument, *joint.part(z)))
        u = range(joint.width, joint.width + U)
        joint = joint.joined(a, through_squash(*joint.part(a), policy.squash.half_range))
        joint = joint.moved(u, policy.squash.centre)
        return self.advanced(joint, [*z, *u]), Gaussian(*joint.part(u))

    def augmented(self, state: Gaussian) -> tuple[Gaussian, list[int]]:
        """The state with the sines and cosines of its angles behind it, and which entries are z."""
        X, z = len(self.A), list(self.augmentation.plain)
        angles = self.augmentation.angles
        if not angles:
            return state, z
        sines = range(X, X + 2 * len(angles), 2)
        joint = state.joined(range(X), through_trig(*state.part(range(X)), angles))
        return joint, [*z, *(i + 1 for i in sines), *sines]

    def advanced(self, joint: Gaussian, zu: list[int]) -> Gaussian:
        """The next state, of a vector that begins with the state and holds the regressors."""
        X, E = len(self.A), self.bases.outputs
        following = joint.joined(zu, through_bases(self.bases, *joint.part(zu)))
        untouched = self.A.new_zeros(X, following.width - X - E)
        return following.mapped(torch.cat([self.A, untouched, self.B], 1))


def predicted(
    dynamics: GaussianDynamics, policy: GPMean, start: Gaussian, horizon: int
) -> tuple[Gaussian, Gaussian]:
    """The states at times 0 to T and the inputs between; gradients flow to the policy.

    Args:
        dynamics: the model.
        policy: the policy.
        start: the state at time 0.
        horizon: T [steps].

    Raises:
        torch.linalg.LinAlgError: a predicted covariance is none, for its numbers overflow.
    """
    argument = policy.bases()
    states, inputs = [start], []
    for _ in range(horizon):
        state, used = dynamics.step(states[-1], policy, argument)
        states.append(state)
        inputs.append(used)
    return Gaussian.stacked(states), Gaussian.stacked(inputs)


Predict = Callable[[GaussianDynamics, GPMean, Gaussian, int], tuple[Gaussian, Gaussian]]
"""`predicted`, or anything that computes the same"""


@dataclass(frozen=True)
class Problem:
    """The objective: the expected cost over the horizon, of one Gaussian in a model."""

    dynamics: GaussianDynamics
    """the model"""
    cost: Cost
    """one that `baselines.moments.expected_cost` knows"""
    start: Gaussian
    """the state at time 0"""
    horizon: int
    """T [steps]"""
    predict: Predict
    """how it is predicted"""

    def prediction(self, policy: GPMean) -> tuple[Gaussian, Gaussian, Float[Tensor, " T"]]:
        """The states at times 0 to T, the inputs between, and the expected cost of each step [-].

        Raises:
            torch.linalg.LinAlgError: a predicted covariance is none, for its numbers overflow.
        """
        states, inputs = self.predict(self.dynamics, policy, self.start, self.horizon)
        after = Gaussian(states.mean[1:], states.cov[1:])
        return states, inputs, expected_cost(self.cost, after, inputs)
