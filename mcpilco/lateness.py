"""Learned models of late actuators, on the way from an actuator that answers at once."""

from __future__ import annotations

import dataclasses

import torch

from mcpilco.dynamics import GPDynamics
from mcpilco.equations.number import Tape
from mcpilco.equations.program import Program
from mcpilco.kernels import ActiveDims


def answering_sooner(dynamics: GPDynamics, past: int, share: float) -> GPDynamics:
    """The same model, asked at past inputs that are on their way from the present one.

        m_k = u + share (u_(t-k) - u)

    At the share 0 the model is told that the input has been what it is now for as long as it
    remembers: an actuator that answers at once. What the states remember stays true.

    Args:
        dynamics: of states behind which past inputs stand, without further regressors.
        past: how many numbers they are, newest inputs first.
        share: of the way; 1: the model itself.
    """
    D, X = dynamics.posterior.X.shape[1], len(dynamics.A)
    plain = list(dynamics.augmentation.plain)
    at = {plain.index(X - past + i): D + i for i in range(past)}
    dims = [at.get(d, d) for d in range(D)]
    posterior = dataclasses.replace(
        dynamics.posterior,
        kernel=ActiveDims(dynamics.posterior.kernel, dims, D + past),
        X=torch.cat([dynamics.posterior.X, dynamics.posterior.X[:, list(at)]], 1),
    )
    U = dynamics.C.shape[1]
    tape = Tape(X + U)
    remembered, now = tape.inputs[X - past : X], tape.inputs[X:]
    told = [now[i % U] + share * (m - now[i % U]) for i, m in enumerate(remembered)]
    law = dynamics.augmentation, dynamics.increment, dynamics.bounds.numpy()
    return GPDynamics(posterior, *law, Program.of(tape, told))
