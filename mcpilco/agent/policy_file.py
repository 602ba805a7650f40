"""The file of a policy alone: plain arrays that act with numpy, without this package."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from mcpilco.dynamics import GPDynamics
from mcpilco.files import write_arrays
from mcpilco.gp import RECENT
from mcpilco.policies import SumOfGaussians
from mcpilco.sensing import Chain, LinearEstimator, PastInputs, StateTracker
from mcpilco.task import TaskSpec
from mcpilco.typing import Estimator, InputError


def write_policy(
    path: str | Path, policy: SumOfGaussians, task: TaskSpec, estimator: Estimator | None = None
) -> Path:
    """Write the numbers that a policy computes with, and their meaning; returns the path.

    Of states x with angles q and other components p the policy answers, within its bounds,

        u = middle + half_range tanh(sum_b w_b exp(-|(z - c_b) / l|^2) / squash),
        z = [p, cos q, sin q]

    `mcpilco.agent.numpy_policy` acts from the file, and imports nothing of this package.

    Args:
        path: of the `.npz` file: `angles` (which states are angles), `centres` (B, Z),
            `lengthscales` (Z), `weights` (B, U), `squash`, `middle` (U) and `half_range` (U);
            `state_names`, `state_units`, which of them are `measured`, `input_names`,
            `input_units`, and the time `dt` for which an input is held [s].
        policy: what is written.
        task: of the env in which it was learned.
        estimator: makes the states that the policy acts on; None: it acts on measured states.
            A linear one is written as `estimator.A` (X, X), `.C` (Y, X), `.gains` (G, X, Y) and
            `.start` (X), see `mcpilco.sensing.estimator.LinearEstimator`; the number of steps whose
            inputs stand behind the state as `past_inputs`; that of a late actuator as `delay.whole`
            and `.part` [steps], `.noise_std` (X), `.recent` [steps], with its model: `motion.A`,
            `.B`, `.C`, `.predicted`, `.bounds` as in `mcpilco.dynamics.Increment`, and the
            posterior `model.X` (N, D), `.L_inv`, `.alpha`, `.noise_std` with the kernel's terms
            `.W`, `.v`, `.w`, `.c`, `.s` and `.ends` (of the factors of each term). A policy's brake
            is written as `brake.constants`, `.operations`, `.first`, `.second` and `.outputs` of
            its program, see `mcpilco.plant.Program`, and a regulator before it as `regulator.*`,
            with its `regulator.goal`.

    Raises:
        InputError: the estimator is of another class, or its model has regressors of its own.
        RunFolderError: the file cannot be written.

    Reference: thesis section 5.5.1.
    """
    return write_arrays(Path(path), policy_arrays(policy, task, estimator))


def policy_arrays(
    policy: SumOfGaussians, task: TaskSpec, estimator: Estimator | None = None
) -> dict[str, np.ndarray]:
    """The arrays that `write_policy` writes of the same arguments, by name."""
    numbers = {
        "centres": policy.centres,
        "lengthscales": policy.lengthscale,
        "weights": policy.weights,
        "middle": policy.squash.centre,
        "half_range": policy.squash.half_range,
    }
    about = {
        "angles": np.array(policy.augmentation.angles, dtype=np.int64),
        "squash": np.array(policy.squash.scale),
        "state_names": np.array(task.state_names),
        "state_units": np.array(task.state_units),
        "measured": np.array(task.measured_states, dtype=np.int64),
        "input_names": np.array(task.input_names),
        "input_units": np.array(task.input_units),
        "dt": np.array(task.dt),
    }
    arrays = {name: value.detach().numpy() for name, value in numbers.items()}
    if policy.regulator is not None and policy.regulator.acts:
        arrays["regulator.goal"] = policy.regulator.goal.numpy()
    stages = _program_arrays(policy, "regulator") | _program_arrays(policy, "brake")
    return arrays | stages | _estimator_arrays(estimator) | about


def _program_arrays(policy: SumOfGaussians, name: str) -> dict[str, np.ndarray]:
    """The program of the stage of this name behind a policy, where it is one that acts."""
    stage = getattr(policy, name)
    program = None if stage is None else stage.program
    if program is None:
        return {}
    parts = "constants", "operations", "first", "second", "outputs"
    return {f"{name}.{part}": getattr(program, part) for part in parts}


def _estimator_arrays(estimator: Estimator | None) -> dict[str, np.ndarray]:
    if estimator is None:
        return {}
    if isinstance(estimator, Chain):
        return _estimator_arrays(estimator.first) | _estimator_arrays(estimator.second)
    if isinstance(estimator, LinearEstimator):
        return {f"estimator.{name}": value.numpy() for name, value in vars(estimator).items()}
    if isinstance(estimator, PastInputs):
        return {"past_inputs": np.array(estimator.count)}
    if isinstance(estimator, StateTracker):
        return _tracker_arrays(estimator)
    raise InputError(
        "A policy is exported with a LinearEstimator, PastInputs or a StateTracker, got "
        f"{type(estimator).__name__}; act with `agent.predict`."
    )


def _tracker_arrays(tracker: StateTracker) -> dict[str, np.ndarray]:
    predictor = tracker.predictor
    delay, known = predictor.delay, predictor.dynamics
    arrays = {"whole": delay.whole, "part": delay.part, "recent": RECENT}
    numbers = {"noise_std": tracker.noise_std} | {k: torch.tensor(v) for k, v in arrays.items()}
    motion = {"A": known.A, "B": known.B, "C": known.C, "bounds": known.bounds}
    motion["predicted"] = torch.tensor(known.predicted)
    groups = {"delay": numbers, "motion": motion, "model": _model_tensors(known, delay.part > 0)}
    return {
        f"{group}.{name}": value.detach().numpy()
        for group, tensors in groups.items()
        for name, value in tensors.items()
    }


def _model_tensors(dynamics: GPDynamics, part: bool) -> dict[str, Tensor]:
    """A posterior, its kernel as canonical terms.

    Raises:
        InputError: the kernel has no such terms, or sees regressors beside [z, u, change of u].
    """
    posterior, U = dynamics.posterior, dynamics.C.shape[1]
    width = dynamics.augmentation.width + U * (2 if part else 1)
    if posterior.X.shape[-1] != width:
        raise InputError(
            "The policy of a late actuator is exported with a model of state and command alone, "
            f"got one with {posterior.X.shape[-1] - width} further regressors, such as those of "
            "friction; train with another kernel, or act with `agent.predict`."
        )
    form = posterior.kernel.canonical()
    factors = [term.c.shape[-1] for term in form.terms]
    return {
        "X": posterior.X,
        "L_inv": posterior.L_inv,
        "alpha": posterior.alpha,
        "noise_std": posterior.noise_std,
        "W": form.W,
        "v": torch.stack([term.v for term in form.terms], -1),
        "w": torch.stack([term.w for term in form.terms], -2),
        "c": torch.cat([term.c for term in form.terms], -1),
        "s": torch.cat([term.s for term in form.terms], -2),
        "ends": torch.tensor([0, *np.cumsum(factors).tolist()]),
    }
