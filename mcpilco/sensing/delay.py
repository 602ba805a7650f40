"""Estimators for actuators that answer late: the state in which the next command will act.

`StateTracker` works on the system: an extended Kalman filter for the state now, and from there the
prediction of `mcpilco.sensing.state_predictor`. `DelayModel` works in the particles of a rollout,
and errs there as such a prediction will err on the system.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from mcpilco.dynamics import Delay, GPDynamics
from mcpilco.gp import Samples
from mcpilco.sensing.estimator import Begun, Inputs, Memory, State
from mcpilco.sensing.state_predictor import StatePredictor, for_each

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
