"""Estimators for actuators that answer late: the state in which the next command will act.

A command acts on the state that the system will be in when it arrives. A policy that answers the
prediction of that state is in the situation of a policy without delay, but that predictions err.
They follow the model from the state now, under the commands that are on their way. Where a model
has seen little it errs alike from step to step, and a policy that acts on such predictions does not
balance: the model therefore learns of each step of the episode as soon as it is over.

`StateTracker` works on the system: an extended Kalman filter for the state now, and from there the
prediction of a `StatePredictor`. `DelayModel` works in the particles of a rollout, and errs there
as such a prediction will err on the system.

Reference: O. J. M. Smith, Chemical Engineering Progress 53 (5), 1957; for learned models T. J.
Walsh et al., Autonomous Agents and Multi-Agent Systems 18 (1), 2009.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from mcpilco.dynamics import Delay, GPDynamics, Increment, turning_regressors
from mcpilco.gp import Further, Samples
from mcpilco.sensing.estimator import Begun, Inputs, Memory, State

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


SMALLEST_NOISE = 1e-9
"""noise of a state that seems to be measured exactly, in its unit"""


@dataclass(frozen=True, eq=False)
class DelayModel:
    """Predictions of the states in which inputs will act, from measurements as old as the delay.

    Particles are rolled out in the model of an actuator that answers at once: their states are
    those in which inputs act. On the system these states are not measured in time. A policy acts on
    the model's prediction of them, which differs from them by what happened since and was not
    expected, and by the noise of the measurement. A policy searched without these differences
    answers them too strongly.

    With x~_k the prediction of a state from the measurement of k steps before,

        x~_0 = measured,    x~_k of the next step = f(x~_(k-1), u),    f the mean of the model,

    the policy acts on x~_d, the delay d rounded up to whole steps. The memory is x~_0, ... x~_d in
    one row; when an episode begins, all are the states where it does.

    On the system predictions are better than here, for they begin at an estimate from all
    measurements, the model learns in the episode, and part of a step is not a whole one: a policy
    is searched for more errors than it will meet.
    """

    dynamics: GPDynamics
    """the model of an actuator that answers at once"""
    delay: Delay

    def begin(self, states: State) -> Memory:
        """The memory before the first measurement of an episode that starts in these states."""
        return states.repeat(*[1] * (states.ndim - 1), self.delay.memory + 1)

    def observe(self, measured: State, memory: Memory, begun: Begun = None) -> tuple[State, Memory]:
        """The prediction that the policy acts on, and the memory with this measurement."""
        if begun is not None:
            memory = torch.where(begun[..., None], self.begin(measured), memory)
        X = measured.shape[-1]
        memory = torch.cat([measured, memory[..., X:]], -1)
        return memory[..., -X:], memory

    def after(self, memory: Memory, inputs: Inputs) -> Memory:
        """The predictions of the next states, behind a place for their measurement."""
        X = self.dynamics.augmentation.state_dim
        asked = memory.unflatten(-1, (-1, X))[..., :-1, :]
        following = self.dynamics.expected(asked, for_each(asked, inputs)).flatten(-2)
        return torch.cat([memory[..., :X], following], -1)


@dataclass(frozen=True, eq=False)
class Track:
    """The memory of a `StateTracker`, for the episodes of a batch."""

    states: Float[Tensor, "*b X"]
    """the estimate at the last measurement, in their units"""
    covariance: Float[Tensor, "*b X X"]
    """of its errors"""
    steps: Samples | None
    """of the episode so far, that the model has learned; None where there is no model"""
    past: Float[Tensor, "*b M_plus_1 U"]
    """the last commands, newest first; before an episode they were 0"""
    begun: Bool[Tensor, "*b"]
    """which of the batch have not been measured yet"""


class StateTracker:
    """Estimates the state in which the next command will act, from all of the episode so far.

        x- = f(x^),    P- = F P F^T + Q,    K = P- (P- + R)^-1,    x^ = x- + K (y - x-)

    f is the mean of the model, F its Jacobian, Q its uncertainty, and R the measurement's noise.
    The policy acts on the prediction from x^ under the commands that are on their way. The model
    learns each step of the episode as soon as it is over.

    Reference: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation,
    2001, section 10.3.

    Differs: the model is learned, in the episode too, and its Jacobian is made of differences.
    """

    def __init__(
        self, predictor: StatePredictor, inputs: int, noise_std: Float[Tensor, " X"] | None = None
    ) -> None:
        """A tracker.

        `inputs` is U. Where the predictor, the model, knows nothing, a state is what is measured;
        then there is no `noise_std` of each state's measurement, in its unit.
        """
        self.predictor = predictor
        self._inputs = inputs
        self._noise_std = noise_std

    @property
    def noise_std(self) -> Float[Tensor, " X"]:
        """Of each state's measurement, in its unit."""
        assert self._noise_std is not None, "there is a model"
        return self._noise_std

    @property
    def _noise(self) -> Float[Tensor, "X X"]:
        """R."""
        return torch.diag(self.noise_std.square())

    def start(self, states: State) -> State:
        """The states in which the first commands of episodes that begin in these will act."""
        return self.predictor(states, self.begin(states).past[..., :-1, :])

    def begin(self, states: Float[Tensor, "*b n"]) -> Track:
        """The memory before the first measurement of an episode."""
        batch, count = states.shape[:-1], self.predictor.delay.memory + 1
        past = states.new_zeros(*batch, count, self._inputs)
        begun = torch.ones(batch, dtype=torch.bool)
        known = self.predictor.knows
        X = len(self.noise_std) if known else states.shape[-1]
        first = states.new_zeros(*batch, X), states.new_zeros(*batch, X, X)
        return Track(*first, self.predictor.no_steps(*batch) if known else None, past, begun)

    @torch.no_grad()
    def observe(self, measured: State, memory: Track, begun: Begun = None) -> tuple[State, Track]:
        """The state in which the next command will act, and the memory with this measurement."""
        begun = memory.begun if begun is None else memory.begun | begun
        past = torch.where(begun[..., None, None], 0.0, memory.past)
        memory = dataclasses.replace(memory, past=past)
        ahead, states = self.predictor, measured
        if memory.steps is not None:
            memory, steps = self._corrected(memory, memory.steps, measured, begun)
            ahead, states = ahead.after(steps), memory.states
        memory = dataclasses.replace(memory, begun=torch.zeros_like(begun))
        return ahead(states, past[..., :-1, :]), memory

    def after(self, memory: Track, inputs: Inputs) -> Track:
        """The memory with a command, of which the oldest gives way to it."""
        past = torch.cat([inputs[..., None, :], memory.past[..., :-1, :]], -2)
        return dataclasses.replace(memory, past=past)

    def _corrected(
        self, track: Track, learned: Samples, measured: State, begun: Bool[Tensor, "*b"]
    ) -> tuple[Track, Samples]:
        """The track at the end of a step, and the steps so far; where it begins, a measurement."""
        if bool(begun.all()):
            first = self._noise.expand(*begun.shape, -1, -1)
            steps = self.predictor.no_steps(*begun.shape)
            return Track(measured, first, steps, track.past, begun), steps
        states, covariance = self._estimated(track, self.predictor.after(learned), measured)
        usable = states.isfinite().all(-1) & covariance.isfinite().all(-1).all(-1) & ~begun
        states = torch.where(usable[..., None], states, measured)
        covariance = torch.where(usable[..., None, None], covariance, self._noise)
        steps = learned.then(*self.predictor.step(track.states, track.past, measured), begun)
        return Track(states, covariance, steps, track.past, begun), steps

    def _estimated(
        self, track: Track, known: StatePredictor, measured: State
    ) -> tuple[State, Float[Tensor, "*b X X"]]:
        """The estimate at the end of a step, and the covariance of its errors."""
        width = measured.shape[-1]
        steps = torch.diag(self.noise_std)  # for the differences: as far as errors are large
        asked = torch.cat([steps[:1] * 0, steps]) + track.states[..., None, :]
        expected, further = known.after_step(asked, track.past).split([1, width], -2)
        F = ((further - expected) / self.noise_std[:, None]).mT
        expected = expected[..., 0, :]
        Q = known.covariance(track.states, track.past, expected)
        P, R = F @ track.covariance @ F.mT + Q, self._noise
        K = torch.linalg.solve_ex(P + R, P).result.mT  # P and R are symmetric
        rest = torch.eye(width) - K
        # Joseph's form: stays symmetric and positive
        covariance = rest @ P @ rest.mT + K @ R @ K.mT
        return expected + (K @ (measured - expected)[..., None])[..., 0], covariance


@torch.no_grad()
def sensor_noise(
    predictor: StatePredictor,
    states: Float[Tensor, "N X"],
    commands: Float[Tensor, "N M_plus_1 U"],
    following: Float[Tensor, "N X"],
) -> Float[Tensor, " X"]:
    """Standard deviation of the measurement noise in each state, in its unit.

    The change in a step is the difference of two measurements: what is noise in it has twice their
    variance. Of the changes that GPs learn it is the noise they found. Positions follow from
    measured velocities; the residual is noise.

    Where noise in one state makes the change of another uncertain, it is counted with that of the
    other, so that an estimate is rather too large.
    """
    known = predictor.dynamics
    noise = torch.empty(states.shape[1], dtype=torch.float64)
    noise[known.predicted] = known.posterior.noise_std
    missed = following - predictor.along(states, commands, following)
    others = [i for i in range(len(noise)) if i not in known.predicted]
    noise[others] = missed[:, others].square().mean(0).sqrt()
    return (noise / math.sqrt(2.0)).clamp_min(SMALLEST_NOISE)
