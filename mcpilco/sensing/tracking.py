"""Where a state is by all measurements of an episode so far: an extended Kalman filter.

A late actuator's policy acts on predictions, and on the way to them the noise of a measurement
grows. What the measurements and commands before say of the same state takes most of it away.

Reference: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation,
2001, section 10.3.

Differs: the model is learned, in the episode too, and its Jacobian is made of differences.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from mcpilco.gp import Samples
from mcpilco.sensing.state_predictor import StatePredictor


@dataclass(frozen=True, eq=False)
class Track:
    """What is known of the episodes of a batch so far."""

    states: Float[Tensor, "*b X"]
    """the estimate now, in their units"""
    covariance: Float[Tensor, "*b X X"]
    """of its errors"""
    steps: Samples
    """what a model learns of them"""


class StateTracker:
    """Tells of measurements and commands the state in which the next command will act.

        x- = f(x^),    P- = F P F^T + Q,    K = P- (P- + R)^-1,    x^ = x- + K (y - x-)

    f is what the model expects, F its Jacobian, Q how uncertain it is, and R the measurement's
    noise. The model learns of each step of the episode as soon as it is over.
    """

    def __init__(
        self, predictor: StatePredictor, noise_std: Float[Tensor, " X"] | None = None
    ) -> None:
        """A tracker.

        Args:
            predictor: the model; where it knows nothing, a state is what is measured.
            noise_std: of each state's measurement, in its unit; None where nothing is known.
        """
        self._predictor = predictor
        self._noise_std = noise_std

    @property
    def noise_std(self) -> Float[Tensor, " X"]:
        """Of each state's measurement, in its unit."""
        assert self._noise_std is not None, "there is a model"
        return self._noise_std

    def begin(self, measured: Float[Tensor, "*b X"]) -> Track | None:
        """What is known by the first measurement of an episode; None where there is no model."""
        if not self._predictor.knows:
            return None
        batch = measured.shape[:-1]
        first = self._noise.expand(*batch, -1, -1)
        return Track(measured, first, self._predictor.no_steps(*batch))

    @property
    def _noise(self) -> Float[Tensor, "X X"]:
        """R."""
        return torch.diag(self.noise_std.square())

    @torch.no_grad()
    def follow(
        self,
        track: Track,
        commands: Float[Tensor, "*b M_plus_1 U"],
        measured: Float[Tensor, "*b X"],
        begun: Bool[Tensor, "*b"],
    ) -> Track:
        """What is known a step later.

        Args:
            track: when the step began.
            commands: that of the step, and those before it, newest first.
            measured: at its end.
            begun: for which of the batch it is the first of an episode, whatever the track says.
        """
        states, covariance = self._corrected(track, commands, measured)
        usable = states.isfinite().all(-1) & covariance.isfinite().all(-1).all(-1) & ~begun
        return Track(
            torch.where(usable[..., None], states, measured),
            torch.where(usable[..., None, None], covariance, self._noise),
            track.steps.then(*self._predictor.step(track.states, commands, measured), begun),
        )

    def _corrected(
        self,
        track: Track,
        commands: Float[Tensor, "*b M_plus_1 U"],
        measured: Float[Tensor, "*b X"],
    ) -> tuple[Float[Tensor, "*b X"], Float[Tensor, "*b X X"]]:
        """The estimate at the end of a step, and the covariance of its errors."""
        known, width = self._predictor.after(track.steps), measured.shape[-1]
        steps = torch.diag(self.noise_std)  # for the differences: as far as errors are large
        asked = torch.cat([steps[:1] * 0, steps]) + track.states[..., None, :]
        expected, further = known.after_step(asked, commands).split([1, width], -2)
        F = ((further - expected) / self.noise_std[:, None]).mT
        expected = expected[..., 0, :]
        Q = known.covariance(track.states, commands, expected)
        P, R = F @ track.covariance @ F.mT + Q, self._noise
        K = torch.linalg.solve_ex(P + R, P).result.mT  # P and R are symmetric
        rest = torch.eye(width) - K
        # Joseph's form: stays symmetric and positive
        covariance = rest @ P @ rest.mT + K @ R @ K.mT
        return expected + (K @ (measured - expected)[..., None])[..., 0], covariance

    def ahead(
        self,
        track: Track | None,
        measured: Float[Tensor, "*b X"],
        past: Float[Tensor, "*b M U"],
    ) -> Float[Tensor, "*b X"]:
        """The expected state after the delay.

        Args:
            track: by the measurements so far; None where there is no model.
            measured: now.
            past: the commands before the one that is sought, newest first.
        """
        if track is None:
            return self._predictor(measured, past)
        return self._predictor.after(track.steps)(track.states, past)
