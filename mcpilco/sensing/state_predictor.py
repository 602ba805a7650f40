"""Where a state will be when the next command acts.

A command acts on the state that the system will be in when it arrives. A policy that answers the
prediction of that state is in the situation of a policy without delay, but that predictions err.
They follow the model from the state now, under the commands that are on their way. Where a model
has seen little it errs alike from step to step, and a policy that acts on such predictions does not
balance: the model therefore learns of each step of the episode as soon as it is over.

The estimate of the state now, and how policies are searched that live with such predictions, are
in `mcpilco.sensing.delay`.

Reference: O. J. M. Smith, Chemical Engineering Progress 53 (5), 1957; for learned models T. J.
Walsh et al., Autonomous Agents and Multi-Agent Systems 18 (1), 2009.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.dynamics import Delay, GPDynamics, Increment, turning_regressors
from mcpilco.gp import Further, Samples
from mcpilco.sensing.estimator import Inputs, State

States = Float[Tensor, "*b N X"]
"""N for each of a batch, in their units"""
Commands = Float[Tensor, "*b M_plus_1 U"]
"""that of a step, and those before it, newest first"""


class StatePredictor:
    """Predicts, by a model, the states in which late commands will act."""

    def __init__(
        self, delay: Delay, dynamics: GPDynamics | None, learned: Further | None = None
    ) -> None:
        """A predictor.

        The dynamics are of an actuator that answers at once; where `delay`, that of the commands,
        has a part, their posterior regresses on [z, mean command, its change, ...]. Without them
        nothing is known, and a state stays where it is. `learned` is the posterior that has learned
        of further steps.
        """
        self.delay = delay
        """of the commands"""
        self._dynamics = dynamics
        self._learned = learned

    @property
    def knows(self) -> bool:
        """Whether there is a model."""
        return self._dynamics is not None

    @property
    def dynamics(self) -> GPDynamics:
        """The model, where there is one."""
        assert self._dynamics is not None, "the caller has asked `knows`"
        return self._dynamics

    def after(self, steps: Samples) -> StatePredictor:
        """The predictor that has learned of the steps of an episode so far."""
        return StatePredictor(self.delay, self._dynamics, self.dynamics.posterior.after(steps))

    def no_steps(self, *batch: int) -> Samples:
        """Those of an episode that begins."""
        posterior = self.dynamics.posterior
        X = posterior.X.new_empty(*batch, 0, posterior.X.shape[-1])
        Y = posterior.X.new_empty(*batch, 0, len(posterior.noise_std))
        return Samples(X, Y, torch.empty(*batch, 0, dtype=torch.bool))

    def step(
        self, states: State, commands: Commands, following: State
    ) -> tuple[Float[Tensor, "*b D"], Float[Tensor, "*b E"]]:
        """Regressors and changes of a measured step, for a model to learn."""
        acting, turned = self.delay.acting(commands)
        asked = self._asked(states, acting, turned if self.delay.part else None)
        return asked, (following - states)[..., self.dynamics.predicted]

    @torch.no_grad()
    def __call__(self, states: State, past: Float[Tensor, "*b M U"]) -> State:
        """The expected states after the delay."""
        if not self.knows:
            return states
        part, whole = self.delay.part, self.delay.whole
        states = states[..., None, :]
        for ahead in range(whole):
            acting = past[..., whole - 1 - ahead :, :]  # newest first
            states = self._stepped(states, acting)
        states = states if part == 0.0 else self._begun(states, past[..., 0, :])
        return states[..., 0, :]

    def after_step(self, states: States, commands: Commands) -> States:
        """The expected states at the end of a step, of N at its beginning."""
        return self._stepped(states, commands[..., self.delay.whole :, :])

    def along(self, states: State, commands: Commands, following: State) -> State:
        """Where positions are expected at the end of a step along which velocities are known.

        All states of the answer that are no such positions are those of `following`.
        """
        known = self.dynamics
        expected = self.after_step(states[..., None, :], commands)[..., 0, :]
        surprise = (following - expected)[..., known.predicted]
        expected = expected + surprise @ known.B.T
        return expected + self._left_out(states, commands, following)

    def covariance(
        self, states: State, commands: Commands, following: State
    ) -> Float[Tensor, "*b X X"]:
        """How uncertain the expected states at the end of a step are.

        Of a change that is what the posterior says; of a position also what is left out where it is
        integrated at constant acceleration.
        """
        known, (acting, turned) = self.dynamics, self.delay.acting(commands)
        asked = self._asked(states, acting, turned if self.delay.part else None)
        _, variance = known.posterior.mean_and_variance(asked[..., None, :])
        unknown = known.B @ torch.diag_embed(variance[..., 0, :]) @ known.B.T
        left_out = self._left_out(states, commands, following)
        return unknown + torch.diag_embed(left_out.square())

    def _left_out(self, states: State, commands: Commands, following: State) -> State:
        """By how much positions are further ahead than at constant acceleration.

        With accelerations a at the beginning and b at the end of a step, by (a - b) dt^2 / 12: the
        model tells (b - a) dt by the changes from here and from there.
        """
        acting, _ = self.delay.acting(commands)
        both = torch.stack([states, following], -2)
        before, after = self._change(both, acting).unbind(-2)
        return (before - after) / 6 @ _integrated(self.dynamics.increment).T

    def _stepped(self, states: States, acting: Float[Tensor, "*b M U"]) -> States:
        """After a step, of the commands that act in it, newest first."""
        if self.delay.part == 0.0:
            return self._held(states, acting[..., 0, :])
        return self._switched(states, acting[..., 0, :], acting[..., 1, :])

    def _held(self, states: States, inputs: Inputs) -> States:
        """After a step in which an input is held."""
        delta = self._change(states, inputs)
        return self.dynamics.advance(states, for_each(states, inputs), delta)

    def _switched(self, states: States, new: Inputs, old: Inputs) -> States:
        """After a step in which one input follows on another.

        The GPs have learned what that does to the changes that they predict. Positions that are
        integrated at constant acceleration are further ahead where the greater acceleration came
        first: with accelerations a and then b, by p (1 - p) (a - b) dt^2 / 2.
        """
        p, known = self.delay.part, self.dynamics
        delta = self._change(states, (1 - p) * new + p * old, new - old)
        sooner = self._change(states, old) - self._change(states, new)
        following = known.advance(states, for_each(states, new), delta)
        return following + p * (1 - p) * sooner @ _integrated(known.increment).T

    def _begun(self, states: States, inputs: Inputs) -> States:
        """After the delay's part of a step in which an input is held.

        A GP's change is that of a whole step, whose middle is later than that of the part: it is
        asked as much further back on the way.
        """
        p, known = self.delay.part, self.dynamics
        back = states - (1 - p) / 2 * (self._held(states, inputs) - states)
        delta, identity = self._change(back, inputs), torch.eye(states.shape[-1])
        drift = states + p * states @ (known.A - identity).T
        integrated = _integrated(known.increment)
        return known.moved(states, drift + (p * p - p) * delta @ integrated.T, p * delta)

    def _change(
        self, states: States, inputs: Inputs, turned: Inputs | None = None
    ) -> Float[Tensor, "*b N E"]:
        change = None if turned is None else for_each(states, turned)
        asked = self._asked(states, for_each(states, inputs), change)
        return (self._learned or self.dynamics.posterior).mean(asked)

    def _asked(self, states: State, inputs: Inputs, turned: Inputs | None) -> Float[Tensor, "*b D"]:
        """The regressors of the GPs; arguments as those of `_change`."""
        known = self.dynamics
        if turned is None:
            return known.regressors(states, inputs)
        law = known.augmentation, known.features
        return turning_regressors(*law, states, inputs, turned)


def for_each(states: States, inputs: Inputs) -> Float[Tensor, "*b N U"]:
    """The same inputs for each of N states."""
    return inputs[..., None, :].expand(*states.shape[:-1], -1)


def _integrated(increment: Increment) -> Float[Tensor, "X E"]:
    """B of the states that follow from predicted changes without being predicted themselves."""
    B = np.array(increment.B)
    B[list(increment.predicted)] = 0.0
    return torch.from_numpy(B)
