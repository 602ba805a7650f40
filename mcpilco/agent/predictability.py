"""How well one observation tells what comes next, and rewards: is the state whole?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from mcpilco.data import Rollout
from mcpilco.dynamics import AngleAugmentation
from mcpilco.gp import GP
from mcpilco.kernels import RBF
from mcpilco.task import TaskSpec

TRAINING, TESTED = 150, 150
"""most samples that the Gaussian processes learn from, and are judged by"""
RESAMPLES = 1000
"""bootstrap samples of the interval"""
NOISE_FLOOR = 0.01
"""least noise, in parts of the target's standard deviation [-]"""


@dataclass(frozen=True)
class Gain:
    """How much better a state's next change is predicted with the observation before as well."""

    unexplained: float
    """error from the present observation and input, in parts of the change's spread [-]"""
    factor: float
    """how many times smaller it is when the observation before is known too [-]"""
    low: float
    """lower end of the 95 % interval of the factor"""
    high: float
    """upper end"""


def state_gains(
    task: TaskSpec, episodes: Sequence[Rollout], rng: np.random.Generator
) -> tuple[Gain, ...]:
    """How much the previous observation improves each state's prediction; empty for short episodes.

    Two Gaussian processes predict the change of each state, one from (x_t, u_t), one from
    (x_t, u_t, x_{t-1}, u_{t-1}), and are judged on held-out samples. Where the state is
    Markov the second is better only by averaging noise.
    """
    usable = [episode for episode in episodes if len(episode) >= 2]
    if sum(len(episode) - 1 for episode in usable) < 40:
        return ()
    states = [episode.observations for episode in usable]
    now = np.concatenate([s[1:-1] for s in states])
    before = np.concatenate([s[:-2] for s in states])
    change = np.concatenate([np.diff(s, axis=0)[1:] for s in states])
    input_now = np.concatenate([episode.inputs[1:] for episode in usable])
    input_before = np.concatenate([episode.inputs[:-1] for episode in usable])
    present = _regressors(task, now, input_now)
    memory = np.hstack([present, _regressors(task, before, input_before)])
    order = rng.permutation(len(now))[: TRAINING + TESTED]
    without, with_memory = (_errors(X[order], change[order]) for X in (present, memory))
    return tuple(
        _gain(without[:, i], with_memory[:, i], float(change[:, i].std()), rng)
        for i in range(change.shape[1])
    )


def reward_share(task: TaskSpec, episodes: Sequence[Rollout], rng: np.random.Generator) -> float:
    """The share of the rewards' variance that the state after the step and its input tell [-].

    Returns:
        1 where all is predicted, 0 or less where nothing is, NaN where all rewards are equal.
    """
    after = np.concatenate([episode.observations[1:] for episode in episodes])
    inputs = np.concatenate([episode.inputs for episode in episodes])
    rewards = np.concatenate([episode.rewards for episode in episodes])[:, None]
    if np.ptp(rewards) == 0.0:
        return float("nan")
    order = rng.permutation(len(after))[: TRAINING + TESTED]
    errors = _errors(_regressors(task, after, inputs)[order], rewards[order])
    return 1.0 - float(np.mean(errors**2) / rewards[order].var())


def _regressors(
    task: TaskSpec, states: Float[np.ndarray, "N X"], inputs: Float[np.ndarray, "N U"]
) -> Float[np.ndarray, "N D"]:
    augmentation = AngleAugmentation(len(task.state_names), task.angles)
    return augmentation.regressors(torch.from_numpy(states), torch.from_numpy(inputs)).numpy()


def _errors(X: Float[np.ndarray, "N D"], Y: Float[np.ndarray, "N E"]) -> Float[np.ndarray, "M E"]:
    """Errors on the second half of the samples of a GP that learned from the first."""
    spread = np.where(Y.std(0) > 0, Y.std(0), 1.0)
    targets, middle = torch.from_numpy((Y - Y.mean(0)) / spread), len(X) // 2
    regressors = torch.from_numpy(X)
    gp = GP(RBF(X.shape[1], (Y.shape[1],)), noise_floor=NOISE_FLOOR)
    gp.fit(regressors[:middle], targets[:middle], max_iterations=100)
    posterior = gp.condition(regressors[:middle], targets[:middle])
    mean, _ = posterior.mean_and_variance(regressors[middle:])
    return (mean - targets[middle:]).detach().numpy() * spread


def _gain(
    without: Float[np.ndarray, " M"],
    with_memory: Float[np.ndarray, " M"],
    spread: float,
    rng: np.random.Generator,
) -> Gain:
    floor = NOISE_FLOOR * spread + 1e-12  # a smaller error is as good as none

    def size(errors: np.ndarray) -> np.ndarray:
        return np.sqrt(np.mean(errors**2, axis=-1)) + floor

    drawn = rng.integers(len(without), size=(RESAMPLES, len(without)))
    low, high = np.quantile(size(without[drawn]) / size(with_memory[drawn]), [0.025, 0.975])
    factor = float(size(without) / size(with_memory))
    return Gain(float(size(without) / (spread + 1e-12)), factor, float(low), float(high))
