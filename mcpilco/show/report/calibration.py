"""Does the predicted spread cover the truth: one step ahead, and along a whole rollout?

A trial's models never saw the trial: its data are held out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import torch
from jaxtyping import Float
from scipy.stats import norm

from mcpilco.agent import find
from mcpilco.config import from_dict
from mcpilco.data import Prediction
from mcpilco.logbook import History, PastTrial, read_transitions
from mcpilco.typing import InputError, RunFolderError

if TYPE_CHECKING:
    from mcpilco.agent import ModelBasedAgent

LEVELS = np.concatenate([np.linspace(0.05, 0.95, 19), [0.99]])
"""nominal levels of the intervals"""


@dataclass(frozen=True)
class OneStep:
    """The changes of the state in one trial, and what its models had said of each."""

    names: tuple[str, ...]
    """states whose change is predicted"""
    units: tuple[str, ...]
    """of these states"""
    errors: Float[np.ndarray, "N E"]
    """measured minus predicted mean, in the states' units"""
    std: Float[np.ndarray, "N E"]
    """predicted standard deviation of the measurement, noise included, in the states' units"""

    def __add__(self, other: OneStep) -> OneStep:
        """Both trials' changes."""
        return OneStep(
            self.names,
            self.units,
            np.concatenate([self.errors, other.errors]),
            np.concatenate([self.std, other.std]),
        )

    def coverage(self, levels: Float[np.ndarray, " L"]) -> Float[np.ndarray, "L E"]:
        """The share of changes within the central interval of each level."""
        widths = norm.ppf((1 + levels) / 2)
        return (np.abs(self.errors / self.std) <= widths[:, None, None]).mean(axis=1)


def one_step(history: History, trial: PastTrial) -> OneStep:
    """Predictions of each step of a trial by the models that were fitted before it.

    Raises:
        RunFolderError: a file is missing or damaged.
        NotPositiveDefiniteError: the data make a covariance singular, which they did not before.
    """
    kind, config = read_agent(history)
    model = kind.make_model(config, history.task)
    arrays = history.run.read_arrays(trial.number, "gp")
    try:
        model.load_arrays(arrays)
    except InputError as error:
        path = history.run.arrays_path(trial.number, "gp")
        raise RunFolderError(f"{path} is damaged, or of another task ({error}).") from error
    X, Y = model.rows(history.transitions_before(trial))
    posterior = model.gp.condition(X, Y)
    Xq, Yq = model.rows(read_transitions(history.run, trial.number))
    with torch.no_grad():
        mean, variance = posterior.mean_and_variance(Xq)
        std = (variance + posterior.noise_std.square()).sqrt()
    units = tuple(history.task.state_units[i] for i in model.increment.predicted)
    return OneStep(model.names, units, (Yq - mean).numpy(), std.numpy())


def read_agent(history: History) -> tuple[type[ModelBasedAgent], Any]:
    """The class of an agent that predicts, and so has a model, and its numbers.

    Raises:
        RunFolderError: config.json does not hold them, or its algorithm is not known here.
    """
    try:
        found = find(history.run.config.get("algo", "mcpilco"))
        kind = cast("type[ModelBasedAgent]", found)
        return kind, from_dict(kind.config_type, history.run.config["config"])
    except InputError as error:
        path = history.run.path / "config.json"
        raise RunFolderError(f"{path} does not hold the agent's numbers: {error}") from error


def rollout_coverage(
    truth: Float[np.ndarray, "T_plus_1 X"], prediction: Prediction, levels: Float[np.ndarray, " L"]
) -> Float[np.ndarray, "L X"]:
    """The share of a rollout's steps at which the central interval of the particles holds it.

    Args:
        truth: states of the system.
        prediction: the particles; compared as far as both go, from the first step on.
        levels: of the intervals.
    """
    steps = min(len(truth), len(prediction.states))
    here, particles = truth[1:steps, None], prediction.states[1:steps]
    # The rank of the truth among the particles, in [0, 1]; a tie counts half.
    rank = ((particles < here) + 0.5 * (particles == here)).mean(axis=1)
    return (np.abs(2 * rank - 1) <= levels[:, None, None]).mean(axis=1)


def rollout_errors(
    truth: Float[np.ndarray, "T_plus_1 X"], prediction: Prediction
) -> Float[np.ndarray, "T X"]:
    """Root mean square over the particles of their distance to the system, at each step.

    Reference: thesis figure 5.5, at the bottom.
    """
    steps = min(len(truth), len(prediction.states))
    distance = prediction.states[:steps] - truth[:steps, None]
    return np.sqrt(np.square(distance).mean(axis=1))
