"""The inputs of a trial's policy over its states: maps of its inputs over two states each."""

from __future__ import annotations

from itertools import combinations, islice, product
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from mcpilco.logbook import History, PastTrial
from mcpilco.show.plots.models import PolicyMap
from mcpilco.show.report.calibration import read_agent
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError, RunFolderError

_POINTS = 61
"""values of each state in a map"""
_MARGIN = 0.3
"""how far a map goes beyond what the rollout visited, in parts of that range"""
_MOST = 6
"""maps in a report; a system of many joints has more pairs than anyone looks at"""


def policy_maps(history: History, trial: PastTrial) -> list[PolicyMap]:
    """A map for each position with its velocity, and for each input; the first six of them.

    The other states are held where the trial's rollout ended.

    Raises:
        RunFolderError: the policy is missing, damaged, or of another task.
    """
    policy = read_policy(history, trial)
    pairs = _pairs(history.task)
    inputs = range(len(history.task.input_names))
    return [
        _policy_map(history.task, trial.rollout.shown_states, policy, pair, index)
        for pair, index in islice(product(pairs, inputs), _MOST)
    ]


def read_policy(history: History, trial: PastTrial) -> Any:
    """The policy of a trial.

    Raises:
        RunFolderError: the policy is missing, damaged, or of another task.
    """
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


def _pairs(task: TaskSpec) -> list[tuple[int, int]]:
    """Which two states a map spans: positions with their velocities, where the task tells."""
    width = len(task.state_names)
    return list(task.velocities) or list(combinations(range(width), 2))


def _policy_map(
    task: TaskSpec,
    states: Float[np.ndarray, "T_plus_1 X"],
    policy: Any,
    pair: tuple[int, int],
    index: int,
) -> PolicyMap:
    """Input `index` over a pair of states, the others as at the end of the rollout."""
    x, y = (_values(states[:, state]) for state in pair)
    grid = np.tile(states[-1], (len(y), len(x), 1))
    grid[..., pair[0]], grid[..., pair[1]] = np.meshgrid(x, y)
    past = policy.augmentation.state_dim - grid.shape[-1]  # inputs that it sees too: none before
    grid = np.pad(grid, ((0, 0), (0, 0), (0, past)))
    with torch.no_grad():
        answers = policy(torch.from_numpy(grid))[..., index].numpy()
        centre, half = policy.squash.centre[index], policy.squash.half_range[index]
    first, second = (f"{task.state_names[i]} [{task.state_units[i]}]" for i in pair)
    return PolicyMap(
        x=x,
        y=y,
        values=answers,
        path=states[:, list(pair)],
        low=float(centre - half),
        high=float(centre + half),
        labels=(first, second, f"{task.input_names[index]} [{task.input_units[index]}]"),
    )


def _values(visited: np.ndarray) -> np.ndarray:
    """Over what was visited, and a little beyond."""
    low, high = float(visited.min()), float(visited.max())
    margin = _MARGIN * (high - low) or 1.0
    return np.linspace(low - margin, high + margin, _POINTS)
