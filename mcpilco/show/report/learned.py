"""The models and policies of a run: do predictions cover the truth, what is answered where?

A trial's models never saw the trial: its data are held out. A policy is a map over two states.
"""

from __future__ import annotations

import contextlib
import logging
from dataclasses import dataclass
from itertools import combinations, islice, product
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import torch
from jaxtyping import Float
from scipy.stats import norm

from mcpilco.agent import agent_of, find, horizon_of, open_run_env
from mcpilco.config import from_dict
from mcpilco.data import Prediction
from mcpilco.logbook import History, PastTrial, read_transitions
from mcpilco.plant import Plant
from mcpilco.show.plots.training import PolicyMap
from mcpilco.sweep import Direction, directions
from mcpilco.typing import InputError, McPilcoError, RunFolderError

if TYPE_CHECKING:
    from mcpilco.agent import ModelBasedAgent

logger = logging.getLogger(__name__)

LEVELS = np.concatenate([np.linspace(0.05, 0.95, 19), [0.99]])
"""nominal levels of the intervals"""
_POINTS = 61
"""values of each state in a map"""
_MARGIN = 0.3
"""how far a map goes beyond what the rollout visited, in parts of that range"""
_MOST = 6
"""maps in a report; a system of many joints has more pairs than anyone looks at"""


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
        errors = np.concatenate([self.errors, other.errors])
        return OneStep(self.names, self.units, errors, np.concatenate([self.std, other.std]))

    def coverage(self, levels: Float[np.ndarray, " L"]) -> Float[np.ndarray, "L E"]:
        """The share of changes within the central interval of each level."""
        widths = norm.ppf((1 + levels) / 2)
        return (np.abs(self.errors / self.std) <= widths[:, None, None]).mean(axis=1)


def one_step(history: History, trial: PastTrial) -> OneStep:
    """Predictions of each step of a trial by the models that were fitted before it."""
    kind, config = read_agent(history)
    model = kind.make_model(config, history.task)
    arrays = history.run.read_arrays(trial.number, "gp")
    try:
        model.load_arrays(arrays)
    except InputError as error:
        path = history.run.arrays_path(trial.number, "gp")
        raise RunFolderError(f"{path} is damaged, or of another task ({error}).") from error
    X, Y = model.rows(model.known(history.transitions_before(trial)))
    posterior = model.gp.condition(X, Y)
    Xq, Yq = model.rows(read_transitions(history.run, trial.number))
    with torch.no_grad():
        mean, variance = posterior.mean_and_variance(Xq)
        std = (variance + posterior.noise_std.square()).sqrt()
    units = tuple(history.task.state_units[i] for i in model.increment.predicted)
    return OneStep(model.names, units, (Yq - mean).numpy(), std.numpy())


def read_agent(history: History) -> tuple[type[ModelBasedAgent], Any]:
    """The class of an agent that predicts, and so has a model, and its numbers."""
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

    They are compared as far as both go, from the first step on.
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


def held_directions(history: History) -> list[Direction]:
    """Success of the last policy over the numbers of its env's plant; none where it shows none."""
    run, trial = history.run, history.learned[-1].number
    try:
        with contextlib.closing(open_run_env(run)) as env:
            plant = getattr(env.unwrapped, "plant", None)
            if not isinstance(plant, Plant):
                return []
            agent = agent_of(run, trial, env)
            env_id, kwargs, seed = (run.config[key] for key in ("env", "env_kwargs", "seed"))
            steps = horizon_of(env, agent.horizon)
            return directions(plant, env_id, kwargs, agent.controller, steps, seed)
    except McPilcoError as error:
        logger.warning("The report has no map of where the policy holds: %s", error)
        return []


def policy_maps(history: History, trial: PastTrial) -> list[PolicyMap]:
    """A map for each position with its velocity, and for each input; the first six of them.

    The other states are held where the trial's rollout ended.
    """
    policy = read_policy(history, trial)
    task, states = history.task, trial.rollout.shown_states
    width, inputs = len(task.state_names), range(len(task.input_names))
    past = policy.augmentation.state_dim - width  # inputs that it sees too: none before
    pairs = task.velocities or combinations(range(width), 2)
    maps = []
    for pair, index in islice(product(pairs, inputs), _MOST):
        x, y = (_values(states[:, state]) for state in pair)
        grid = np.tile(states[-1], (len(y), len(x), 1))
        grid[..., pair[0]], grid[..., pair[1]] = np.meshgrid(x, y)
        grid = np.pad(grid, ((0, 0), (0, 0), (0, past)))
        with torch.no_grad():
            answers = policy(torch.from_numpy(grid))[..., index].numpy()
            centre, half = policy.squash.centre[index], policy.squash.half_range[index]
        first, second = (f"{task.state_names[i]} [{task.state_units[i]}]" for i in pair)
        label = f"{task.input_names[index]} [{task.input_units[index]}]"
        path, ends = states[:, list(pair)], (float(centre - half), float(centre + half))
        maps.append(PolicyMap(x, y, answers, path, *ends, (first, second, label)))
    return maps


def read_policy(history: History, trial: PastTrial) -> Any:
    """The policy of a trial."""
    arrays = history.run.read_arrays(trial.number, "policy")
    try:
        centre, half_range = arrays["squash.centre"], arrays["squash.half_range"]
        low, high = centre - half_range, centre + half_range
        kind, config = read_agent(history)
        policy = kind.make_policy(config, history.task, low, high)
        policy.load_state_dict({name: torch.from_numpy(array) for name, array in arrays.items()})
    except (KeyError, TypeError, ValueError, RuntimeError, InputError) as error:
        path = history.run.arrays_path(trial.number, "policy")
        raise RunFolderError(f"{path} is damaged, or of another task ({error}).") from error
    return policy


def _values(visited: np.ndarray) -> np.ndarray:
    """Over what was visited, and a little beyond."""
    low, high = float(visited.min()), float(visited.max())
    margin = _MARGIN * (high - low) or 1.0
    return np.linspace(low - margin, high + margin, _POINTS)
