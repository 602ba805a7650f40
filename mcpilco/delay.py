"""Actuators that answer late: which commands act in a step, and where a state will be by then.

A command acts on the state that the system will be in when it arrives. A policy that answers the
prediction of that state is in the situation of a policy without delay, and is searched as one: in
the model of an actuator that answers at once. The prediction follows the model from what is
measured now, under the commands that are on their way. Where a model has seen little it errs alike
from step to step, and a policy that acts on such predictions does not balance: the model therefore
learns of each step of the episode as soon as it is over.

Reference: O. J. M. Smith, Chemical Engineering Progress 53 (5), 1957; for learned models T. J.
Walsh et al., Autonomous Agents and Multi-Agent Systems 18 (1), 2009.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.dynamics import GPDynamics, Increment, regressors
from mcpilco.equations import Program
from mcpilco.features import AngleAugmentation
from mcpilco.gp import Further, Samples
from mcpilco.typing import InputError

MOST = 100
"""longest delay [samples]"""
ROUNDED = 1e-6
"""part of a sample that a delay is rounded by [-]"""


@dataclass(frozen=True)
class Delay:
    """How late commands act, in sampling times: d = whole + part."""

    whole: int = 0
    """whole sampling times"""
    part: float = 0.0
    """of another one, in [0, 1)"""

    @classmethod
    def of(cls, seconds: float, dt: float) -> Delay:
        """The delay of so many seconds.

        Args:
            seconds: at least 0.
            dt: sampling time [s].

        Raises:
            InputError: it is longer than `MOST` samples.
        """
        samples = seconds / dt
        if samples > MOST:
            raise InputError(
                f"model.delay must be at most {MOST} sampling times of {dt:g} s, got {seconds:g} s."
            )
        whole = int(samples + ROUNDED)
        part = samples - whole
        return cls(whole, part if part > ROUNDED else 0.0)

    @property
    def memory(self) -> int:
        """How many past commands are on their way."""
        return self.whole + (self.part > 0.0)

    def acting(
        self, commands: Float[Tensor, "*b M_plus_1 U"]
    ) -> tuple[Float[Tensor, "*b U"], Float[Tensor, "*b U"]]:
        """The mean of the command that acts during a step, and by how much it changes in it.

        Args:
            commands: that of the step, and those before it, newest first.
        """
        new = commands[..., self.whole, :]
        if self.part == 0.0:
            return new, torch.zeros_like(new)
        old = commands[..., self.whole + 1, :]
        return (1 - self.part) * new + self.part * old, new - old


def turning_regressors(
    augmentation: AngleAugmentation,
    features: Program | None,
    states: Float[Tensor, "*b X"],
    acting: Float[Tensor, "*b U"],
    turned: Float[Tensor, "*b U"],
) -> Float[Tensor, "*b D"]:
    """What GPs regress on in a step in which two commands act: [z, mean, change, features].

    Args:
        augmentation: from the state to z.
        features: further regressors, of [state, mean command]; the first U stand for the change.
        states: before the step.
        acting: the mean of the command in the step.
        turned: by how much it changes.
    """
    asked = regressors(augmentation, features, states, acting)
    begin = augmentation.width + acting.shape[-1]
    asked[..., begin : begin + turned.shape[-1]] = turned
    return asked


class StatePredictor:
    """Where a state will be when the next command acts."""

    def __init__(
        self, delay: Delay, dynamics: GPDynamics | None, learned: Further | None = None
    ) -> None:
        """A predictor.

        Args:
            delay: of the commands.
            dynamics: of an actuator that answers at once; where `delay` has a part, its posterior
                regresses on [z, mean command, its change, ...]. None: nothing is known, and a state
                stays where it is.
            learned: the posterior that has learned of further steps; None: of none.
        """
        self._delay = delay
        self._dynamics = dynamics
        self._learned = learned

    def after(self, steps: Samples | None) -> StatePredictor:
        """The predictor that has learned of the steps of an episode so far."""
        learned = None if steps is None else self._known.posterior.after(steps)
        return StatePredictor(self._delay, self._dynamics, learned)

    def no_steps(self, *batch: int) -> Samples | None:
        """Those of an episode that begins; None where nothing is known that could learn of them."""
        if self._dynamics is None:
            return None
        posterior = self._dynamics.posterior
        X = posterior.X.new_empty(*batch, 0, posterior.X.shape[-1])
        Y = posterior.X.new_empty(*batch, 0, len(posterior.noise_std))
        return Samples(X, Y, torch.empty(*batch, 0, dtype=torch.bool))

    def step(
        self,
        states: Float[Tensor, "*b X"],
        commands: Float[Tensor, "*b M_plus_1 U"],
        following: Float[Tensor, "*b X"],
    ) -> tuple[Float[Tensor, "*b D"], Float[Tensor, "*b E"]]:
        """What a model learns of a step: regressors and changes.

        Args:
            states: when it began.
            commands: that of the step, and those before it, newest first.
            following: measured at its end.
        """
        acting, turned = self._delay.acting(commands)
        asked = self._asked(states, acting, turned if self._delay.part else None)
        return asked, (following - states)[..., self._known.predicted]

    @torch.no_grad()
    def __call__(
        self, states: Float[Tensor, "*b X"], past: Float[Tensor, "*b M U"]
    ) -> Float[Tensor, "*b X"]:
        """The expected states after the delay.

        Args:
            states: now.
            past: the commands before the one that is sought, newest first.
        """
        if self._dynamics is None:
            return states
        part, whole = self._delay.part, self._delay.whole
        for ahead in range(whole):
            first = whole - 1 - ahead  # the newest command that acts in this step
            if part == 0.0:
                states = self._held(states, past[..., first, :])
            else:
                states = self._switched(states, past[..., first, :], past[..., first + 1, :])
        return states if part == 0.0 else self._begun(states, past[..., 0, :])

    def _held(
        self, states: Float[Tensor, "*b X"], inputs: Float[Tensor, "*b U"]
    ) -> Float[Tensor, "*b X"]:
        """After a step in which an input is held."""
        return self._known.advance(states, inputs, self._change(states, inputs))

    def _switched(
        self, states: Float[Tensor, "*b X"], new: Float[Tensor, "*b U"], old: Float[Tensor, "*b U"]
    ) -> Float[Tensor, "*b X"]:
        """After a step in which one input follows on another.

        The GPs have learned what that does to the changes that they predict. Positions that are
        integrated at constant acceleration are further ahead where the greater acceleration came
        first: with accelerations a and then b, by p (1 - p) (a - b) dt^2 / 2.
        """
        p, known = self._delay.part, self._known
        delta = self._change(states, (1 - p) * new + p * old, new - old)
        sooner = self._change(states, old) - self._change(states, new)
        following = known.advance(states, new, delta)
        return following + p * (1 - p) * sooner @ _integrated(known.increment).T

    def _begun(
        self, states: Float[Tensor, "*b X"], inputs: Float[Tensor, "*b U"]
    ) -> Float[Tensor, "*b X"]:
        """After the delay's part of a step in which an input is held.

        A GP's change is that of a whole step, whose middle is later than that of the part: it is
        asked as much further back on the way.
        """
        p, known = self._delay.part, self._known
        back = states - (1 - p) / 2 * (self._held(states, inputs) - states)
        delta, identity = self._change(back, inputs), torch.eye(states.shape[-1])
        drift = states + p * states @ (known.A - identity).T
        integrated = _integrated(known.increment)
        return known.moved(states, drift + (p * p - p) * delta @ integrated.T, p * delta)

    def _change(
        self,
        states: Float[Tensor, "*b X"],
        inputs: Float[Tensor, "*b U"],
        turned: Float[Tensor, "*b U"] | None = None,
    ) -> Float[Tensor, "*b E"]:
        """The expected changes in a step.

        Args:
            states: before it.
            inputs: mean of those that act in it.
            turned: by how much they change in it; None: not at all.
        """
        asked = self._asked(states, inputs, turned)
        if self._learned is not None:
            return self._learned.mean(asked[..., None, :])[..., 0, :]
        mean, _ = self._known.posterior.mean_and_variance(asked.reshape(-1, asked.shape[-1]))
        return mean.reshape(*asked.shape[:-1], -1)

    def _asked(
        self,
        states: Float[Tensor, "*b X"],
        inputs: Float[Tensor, "*b U"],
        turned: Float[Tensor, "*b U"] | None,
    ) -> Float[Tensor, "*b D"]:
        """What the GPs regress on; arguments as those of `_change`."""
        known = self._known
        if turned is None:
            return known.regressors(states, inputs)
        law = known.augmentation, known.features
        return turning_regressors(*law, states, inputs, turned)

    @property
    def _known(self) -> GPDynamics:
        assert self._dynamics is not None, "__call__ has looked"
        return self._dynamics


def _integrated(increment: Increment) -> Float[Tensor, "X E"]:
    """B of the states that follow from predicted changes without being predicted themselves."""
    B = np.array(increment.B)
    B[list(increment.predicted)] = 0.0
    return torch.from_numpy(B)
