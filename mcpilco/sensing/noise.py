"""How exactly the states of recorded steps were measured."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.sensing.state_predictor import StatePredictor

LEAST = 1e-9
"""noise of a state that seems to be measured exactly, in its unit"""


@torch.no_grad()
def sensor_noise(
    predictor: StatePredictor,
    states: Float[Tensor, "N X"],
    commands: Float[Tensor, "N M_plus_1 U"],
    following: Float[Tensor, "N X"],
) -> Float[Tensor, " X"]:
    """Standard deviation of the noise in each state, in its unit.

    The change in a step is the difference of two measurements: what is noise in it has twice their
    variance. Of the changes that GPs learn it is what they found. Positions follow from measured
    velocities; what they differ by is noise.

    Where noise in one state makes the change of another uncertain, it is counted with that of the
    other, so that an estimate is rather too large.

    Args:
        predictor: the model fitted to these steps.
        states: at their beginning, measured.
        commands: of them and of those before, newest first.
        following: at their end, measured.
    """
    known = predictor.dynamics
    noise = torch.empty(states.shape[1], dtype=torch.float64)
    noise[known.predicted] = known.posterior.noise_std
    missed = following - predictor.along(states, commands, following)
    others = [i for i in range(len(noise)) if i not in known.predicted]
    noise[others] = missed[:, others].square().mean(0).sqrt()
    return (noise / math.sqrt(2.0)).clamp_min(LEAST)
