"""The file of a policy alone: plain arrays that act with numpy, without this package."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mcpilco.files import write_arrays
from mcpilco.policies import SumOfGaussians
from mcpilco.sensing import Perception
from mcpilco.task import TaskSpec


def write_policy(
    path: str | Path,
    policy: SumOfGaussians,
    task: TaskSpec,
    perception: Perception | None = None,
) -> Path:
    """Write what a policy computes with, and what its numbers mean; returns the path.

    Of states x with angles q and other components p the policy answers, within its bounds,

        u = middle + half_range tanh(sum_b w_b exp(-|(z - c_b) / l|^2) / squash),
        z = [p, cos q, sin q]

    Args:
        path: of the `.npz` file: `angles` (which states are angles), `centres` (B, Z),
            `lengthscales` (Z), `weights` (B, U), `squash`, `middle` (U) and `half_range` (U);
            `state_names`, `state_units`, `input_names`, `input_units`, and the time `dt` for which
            an input is held [s].
        policy: what is written.
        task: of the env in which it was learned.
        perception: what the policy acts behind, where states are measured in part; its estimator
            is written as `estimator.A` (X, X), `estimator.C` (Y, X), `estimator.gains` (G, X, Y)
            and `estimator.start` (X), see `mcpilco.sensing.estimator.LinearEstimator`.

    Raises:
        RunFolderError: the file cannot be written.

    Reference: thesis section 5.5.1.
    """
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
        "input_names": np.array(task.input_names),
        "input_units": np.array(task.input_units),
        "dt": np.array(task.dt),
    }
    arrays = {name: value.detach().numpy() for name, value in numbers.items()}
    if perception is not None:
        estimator = vars(perception.estimator).items()
        arrays |= {f"estimator.{name}": value.numpy() for name, value in estimator}
    return write_arrays(Path(path), arrays | about)
