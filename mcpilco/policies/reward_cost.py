"""A cost learned from observed rewards, for an env whose cost nobody has written down."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.data import Rollout
from mcpilco.dynamics import AngleAugmentation
from mcpilco.gp import GP, Posterior, evenly_spaced, subset_of_data
from mcpilco.kernels import RBF
from mcpilco.policies.costs import costs_along
from mcpilco.task import TaskSpec
from mcpilco.typing import Cost, InputError

NOISE_FLOOR = 0.01
"""least noise of a cost [-]: a hundredth of the way from the best reward to the worst"""
THRESHOLD = 1.0
"""a sample is kept if its cost is uncertain by more than so many noise standard deviations [-]"""
FITTED = 300
"""most samples that the hyperparameters are fitted to; more are thinned out evenly"""


class RewardCost:
    """c(x, u) = 1 + m(z, u), a Gaussian process of rewards: 0 at the best, 1 at the worst.

        c = (best - r) / (best - worst),    c - 1 ~ GP(0, RBF)

    The prior is that a state nobody has seen is as bad as the worst, so the policy search keeps to
    where rewards are known to be good, and gets there by the gradient of m. Rewards are those of
    the state at the end of a step and the input held in it. It can be wrong where rewards depend on
    more than that, or jump where few samples are.
    """

    def __init__(self, task: TaskSpec) -> None:
        states, inputs = len(task.state_names), len(task.input_names)
        self._augmentation = AngleAugmentation(states, task.angles)
        self.states = np.empty((0, states))
        """at the ends of steps"""
        self.inputs = np.empty((0, inputs))
        """held in these steps"""
        self.rewards = np.empty(0)
        """received at their ends [-]"""
        self.baseline = 0.0
        """mean reward of a step of random inputs [-]"""
        kernel = RBF(self._augmentation.width + inputs, (1,))
        self._gp = GP(kernel, noise_floor=NOISE_FLOOR, names=("cost",))
        self._posterior: Posterior | None = None

    def add(self, record: Rollout) -> None:
        """Take an episode's rewards among the samples; `fit` learns from them."""
        self.states = np.concatenate([self.states, record.transitions().next_states])
        self.inputs = np.concatenate([self.inputs, record.inputs])
        self.rewards = np.concatenate([self.rewards, record.rewards])

    def fit(self) -> None:
        """Learn the cost anew from all samples.

        Raises:
            InputError: there are none, or all rewards are equal, which says nothing.
            NotPositiveDefiniteError: no jitter makes the covariance of the GP factorisable.
        """
        if len(self.rewards) == 0 or np.ptp(self.rewards) == 0.0:
            raise InputError(
                f"A cost is learned from rewards that differ, got {len(self.rewards)} equal ones; "
                "give the task a cost, or record longer episodes (--horizon)."
            )
        X, Y = self._rows()
        thinned = evenly_spaced(len(X), FITTED)
        self._gp.fit(X[thinned], Y[thinned])
        self._condition()

    def _rows(self) -> tuple[Float[Tensor, "N D"], Float[Tensor, "N 1"]]:
        X = self._augmentation.regressors(
            torch.from_numpy(self.states), torch.from_numpy(self.inputs)
        )
        return X, torch.from_numpy(self.of_rewards(self.rewards) - 1.0)[:, None]

    def _condition(self) -> None:
        X, Y = self._rows()
        kept = subset_of_data(self._gp, X, Y, THRESHOLD)
        self._posterior = self._gp.condition(X[kept], Y[kept])

    @property
    def samples(self) -> int:
        """How many samples the posterior is made of."""
        return 0 if self._posterior is None else len(self._posterior.X)

    @property
    def reference(self) -> float:
        """Mean cost of a step of random inputs [-]."""
        return float(self.of_rewards(np.array([self.baseline]))[0])

    def of_rewards(self, rewards: Float[np.ndarray, "*b"]) -> Float[np.ndarray, "*b"]:
        """The costs that rewards stand for [-]."""
        best, worst = self.rewards.max(), self.rewards.min()
        return (best - rewards) / (best - worst)

    def __call__(
        self, states: Float[Tensor, "*b X"], inputs: Float[Tensor, "*b U"]
    ) -> Float[Tensor, "*b"]:
        """The mean cost of each state and the input before it, differentiable [-].

        Raises:
            InputError: nothing was learned yet.
        """
        if self._posterior is None:
            raise InputError("A cost learned from rewards needs some first; call learn.")
        here = torch.device("cpu")
        X = self._augmentation.regressors(states, inputs).to(here)
        posterior = self._posterior
        K = posterior.kernel(posterior.X, X.reshape(-1, X.shape[-1])[None])
        mean = 1.0 + (posterior.alpha[:, None, :] @ K).reshape(states.shape[:-1])
        return mean.to(states.device)

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Samples and hyperparameters: what `load_arrays` reads."""
        samples = {"states": self.states, "inputs": self.inputs, "rewards": self.rewards}
        gp = {f"gp.{name}": array for name, array in self._gp.to_arrays().items()}
        return {**samples, **gp, "baseline": np.array(self.baseline)}

    def load_arrays(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Take what `to_arrays` gave.

        Raises:
            InputError: an entry is missing, of another shape, or not finite.
        """
        named = dict(arrays)
        _require_samples(named, self.states.shape[1], self.inputs.shape[1])
        self.states, self.inputs, self.rewards = (named.pop(name) for name in SAMPLES)
        self.baseline = float(named.pop("baseline"))
        self._gp.load_arrays({name.removeprefix("gp."): array for name, array in named.items()})
        if len(self.rewards):
            self._condition()


def with_cost(task: TaskSpec) -> TaskSpec:
    """The task, with a cost to be learned where it has none."""
    return task if task.cost is not None else dataclasses.replace(task, cost=RewardCost(task))


def costs_of(cost: Cost | None, record: Rollout) -> Float[np.ndarray, " T"]:
    """The cost at the end of each step of a rollout [-]: a learned one is that of the rewards.

    Without a cost it is 1 - reward, as the rewards of this package's envs are 1 - cost.
    """
    if cost is None:
        return 1.0 - record.rewards
    if isinstance(cost, RewardCost):
        return cost.of_rewards(record.rewards)
    return costs_along(cost, record.shown_states[1:], record.inputs)


SAMPLES = ("states", "inputs", "rewards")
"""names of the arrays with a row a sample"""


def _require_samples(arrays: Mapping[str, np.ndarray], states: int, inputs: int) -> None:
    """Raises InputError unless samples and baseline are there, fit one another, and are finite."""
    missing = {*SAMPLES, "baseline"} - set(arrays)
    if missing:
        raise InputError(f"A saved cost needs {sorted(missing)}; save the agent anew.")
    count = len(arrays["rewards"]) if arrays["rewards"].ndim else 0
    shapes: Sequence[tuple[int, ...]] = [(count, states), (count, inputs), (count,), ()]
    for name, shape in zip((*SAMPLES, "baseline"), shapes, strict=True):
        array = arrays[name]
        if array.shape != shape or not np.isfinite(array).all():
            raise InputError(
                f"A saved cost's {name} must be finite with shape {shape}, got shape {array.shape}."
            )
