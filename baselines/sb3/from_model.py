"""MC-PILCO as a source of data: a replay buffer that is filled from its model.

agent = SACAgent("MlpPolicy", "mcpilco/CartPoleSwingUp-v0", seed=0)
warm_start(agent, MCPILCO.load("run/agent.npz", "mcpilco/CartPoleSwingUp-v0"))
agent.learn(600)  # steps of the env
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from baselines.sb3.agent import SB3Agent
from baselines.sb3.library import random_numbers
from mcpilco.agent import MCPILCO, agent_of, difference, finished_trial
from mcpilco.config import Checked
from mcpilco.data import Transitions
from mcpilco.logbook import RunFolder
from mcpilco.policies import RewardCost
from mcpilco.search import Problem, rollout
from mcpilco.typing import InputError


@dataclass(frozen=True)
class WarmStart(Checked):
    """How much is taken from the model, and what is made of it.

    First come particles that follow the policy of MC-PILCO, perturbed, or nothing but chance; then
    rounds in which some follow the agent's own policy of the moment, as in model-based policy
    optimisation (Janner et al. 2019). After each the networks are trained on all so far.
    """

    particles: int = 300
    """rollouts at first, each a horizon long"""
    random: float = 0.2
    """share of them with uniform random inputs throughout [-]"""
    interrupted: float = 0.4
    """share with random inputs for a while, uniform up to the horizon, and then the policy [-]; the
    rest has the policy from the start"""
    noise: float = 0.3
    """standard deviation, at most, of what is added to the policy's inputs, relative to half their
    range; each particle has its own, uniform from 0 [-]"""
    first_steps: int = 1000
    """gradient steps on these"""
    rounds: int = 10
    """further rounds; 0: the agent's own policy is not tried in the model"""
    own_particles: int = 60
    """rollouts of a round, of the agent's policy with its noise"""
    round_steps: int = 500
    """gradient steps of a round"""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._at_least(particles=1, own_particles=1, random=0.0, interrupted=0.0, noise=0.0)
        self._at_least(first_steps=0, rounds=0, round_steps=0)
        if self.random + self.interrupted > 1.0:
            raise InputError(
                "The shares random and interrupted must not exceed 1 together, got "
                f"{self.random} and {self.interrupted}."
            )

    @property
    def rollouts(self) -> int:
        """All particles together."""
        return self.particles + self.rounds * self.own_particles


_TOLERANCE = 0.05
"""mean difference between rewards and 1 - cost that noise may make [-]"""

DEFAULT = WarmStart()
"""what is taken where nothing is said"""


def warm_start(agent: SB3Agent, source: MCPILCO, numbers: WarmStart | None = None) -> None:
    """Fill an agent's replay buffer from another's model, and train its networks on that.

    The agent then acts by its policy from the first step on, without random inputs. The steps that
    the model was learned from count as experience of this agent too (`borrowed_timesteps`).

    The agent is SAC or TQC, and new; the source has learned a model of the same system; the numbers
    are those of `WarmStart` by default.

    Raises:
        InputError: the agent has no replay buffer, too small a one, or has learned already; or the
            source is of another system, has learned nothing, or sees a part of its states.
    """
    numbers = DEFAULT if numbers is None else numbers
    check_warm_start(agent, source, numbers)

    def own(states: Float[Tensor, "P X"], dropout: Any = None, step: int = 0) -> Tensor:
        """The agent's policy with its noise, for particles."""
        return torch.from_numpy(agent.inputs_in(states.numpy(), deterministic=False))

    imagination, seed = Imagination(source), int(agent.streams.inputs(trial=0).integers(2**31))
    generator = torch.Generator().manual_seed(seed)
    agent.borrow(source.num_timesteps)
    with random_numbers(seed):
        policy: Any = _perturbed(source, numbers, generator)
        rows = imagination.rollouts(policy, numbers.particles, generator)
        _learn(agent, rows, numbers.first_steps)
        for _ in range(numbers.rounds):
            rows = imagination.rollouts(own, numbers.own_particles, generator)
            _learn(agent, rows, numbers.round_steps)


def stored_source(path: Path, agent: Any) -> MCPILCO:
    """The agent of a run of MC-PILCO, after its last trial, as the source of a warm start.

    Raises:
        InputError: the run is of another algorithm or system, or its cost is not that of the
            rewards; or the new agent cannot use it.
        RunFolderError: the run has no finished trial, or cannot be read.
    """
    if not isinstance(agent, SB3Agent):
        raise InputError(f"--warm-start is for sac and tqc, got --algo {agent.algo}.")
    run = RunFolder.open(path)
    if (algo := run.config.get("algo", "mcpilco")) != "mcpilco":
        raise InputError(
            f"--warm-start takes a run of the algorithm mcpilco, got {path} of {algo}."
        )
    trial = finished_trial(run)
    source: Any = agent_of(run, trial, agent.env)
    rollout = run.read_arrays(trial, "rollout")
    learned = isinstance(source.task.cost, RewardCost) or "costs" not in rollout
    if not learned and np.abs(1.0 - rollout["costs"] - rollout["rewards"]).mean() > _TOLERANCE:
        raise InputError(
            f"The rewards in {path} are not 1 - cost, so what its model would be rewarded with is "
            "not what the env gives; give the task a cost of 1 - reward."
        )
    check_warm_start(agent, source)
    return source


def check_warm_start(agent: SB3Agent, source: MCPILCO, numbers: WarmStart | None = None) -> None:
    """Make sure of what `warm_start` asks of the agents; it takes no time."""
    numbers = DEFAULT if numbers is None else numbers
    buffer = getattr(agent.learner, "replay_buffer", None)
    if buffer is None:
        raise InputError(
            f"A warm start fills a replay buffer, the algorithm {agent.algo} has none; "
            "take sac or tqc."
        )
    if agent.num_timesteps or agent.borrowed_timesteps:
        raise InputError("A warm start is for a new agent, got one that has learned already.")
    if different := difference(source.task, agent.task):
        name, there, here = different
        raise InputError(
            f"A warm start needs a model of the same system; its {name} is {there}, the agent's "
            f"env has {here}."
        )
    if not source.trials:
        raise InputError("A warm start needs an agent that has done a trial, got one without.")
    if source.perception is not None or source.task.cost is None:
        raise InputError(
            "A warm start needs a model of states that are all measured, got an agent that "
            "estimates some of them."
        )
    if source.model.memory:
        raise InputError(
            "A warm start needs a model whose states hold no past inputs, got model.memory "
            f"{source.model.memory}."
        )
    room, brought = buffer.buffer_size * buffer.n_envs, numbers.rollouts * source.horizon
    if brought > room:
        raise InputError(
            f"The replay buffer holds {room} transitions, the warm start brings {brought}; raise "
            "buffer_size, or take fewer particles or rounds."
        )


def _perturbed(source: MCPILCO, numbers: WarmStart, generator: torch.Generator) -> Perturbed:
    """The policies that particles follow first: chance, chance for a while, the policy."""
    count, horizon = numbers.particles, source.horizon
    draw = torch.rand(2, count, generator=generator, dtype=torch.float64)
    begin = torch.zeros(count, dtype=torch.float64)
    random, interrupted = round(numbers.random * count), round(numbers.interrupted * count)
    begin[:random] = horizon
    begin[random : random + interrupted] = horizon * draw[0, random : random + interrupted]
    return Perturbed(source, begin, numbers.noise * draw[1], generator)


def _learn(agent: SB3Agent, rows: Imagined, gradient_steps: int) -> None:
    """Put transitions where those of the env would stand, and train on all that is there.

    The end of a horizon is no end of the task, so none is marked.
    """
    buffer, view = agent.learner.replay_buffer, agent.view
    columns = {
        "observations": view.features(rows.states),
        "next_observations": view.features(rows.next_states),
        "actions": view.actions(rows.inputs),
        "rewards": rows.rewards,
    }
    count = len(rows) // buffer.n_envs
    for name, values in columns.items():
        place = getattr(buffer, name)[buffer.pos : buffer.pos + count]
        place[:] = values[: count * buffer.n_envs].reshape(place.shape)
    end = buffer.pos + count
    buffer.pos, buffer.full = end % buffer.buffer_size, end == buffer.buffer_size
    if gradient_steps:
        agent.learner.train(gradient_steps, agent.config.batch_size)


@dataclass(frozen=True)
class Imagined(Transitions):
    """N transitions of particles, and their rewards."""

    rewards: Float[np.ndarray, " N"]
    """at the end of each step [-]"""


@dataclass(frozen=True)
class Perturbed:
    """A policy that particles follow with noise of their own, after random inputs of their own."""

    source: MCPILCO
    """whose policy it is"""
    begin: Float[Tensor, " P"]
    """step at which each particle begins to follow it; before, inputs are uniform"""
    std: Float[Tensor, " P"]
    """of the noise of each, relative to half the inputs' range [-]"""
    generator: torch.Generator
    """of all noise"""

    def __call__(
        self, states: Float[Tensor, "P X"], dropout: Any = None, step: int = 0
    ) -> Float[Tensor, "P U"]:
        """The inputs of all particles, in the env's unit."""
        policy = self.source.policy
        centre, half_range = policy.squash.centre, policy.squash.half_range
        wanted = (policy(states) - centre) / half_range
        normal = torch.randn(wanted.shape, generator=self.generator, dtype=wanted.dtype)
        uniform = 2.0 * torch.rand(wanted.shape, generator=self.generator, dtype=wanted.dtype) - 1
        noisy = (wanted + self.std[:, None] * normal).clamp(-1.0, 1.0)
        follows = (step >= self.begin)[:, None]
        return centre + half_range * torch.where(follows, noisy, uniform)


class Imagination:
    """Rollouts in the model of an agent, conditioned on all its data; they start as episodes do.

    Rewards are 1 - cost, as those of this package's envs; where the cost was learned from rewards,
    they are those that it stands for.
    """

    def __init__(self, source: MCPILCO) -> None:
        """The model of an agent that `check_warm_start` finds nothing wrong with.

        Raises:
            NotPositiveDefiniteError: the model cannot be conditioned on the data.
        """
        data, task = source.transitions, source.task
        assert data is not None, "check_warm_start has seen to it"
        assert task.cost is not None
        self._cost = task.cost
        self._problem = Problem(
            dynamics=source.model.dynamics(data),
            cost=task.cost,
            start_mean=torch.tensor(task.start_mean, dtype=torch.float64),
            start_std=torch.tensor(task.start_std, dtype=torch.float64),
            horizon=source.horizon,
            reference_cost=source.reference_cost,
            rollout=rollout,
        )

    def rollouts(self, policy: Any, count: int, generator: torch.Generator) -> Imagined:
        """Transitions of so many particles that follow a policy.

        Raises:
            InputError: the model predicts nothing finite.
        """
        with torch.no_grad():
            particles = self._problem.particles(policy, count, generator)
            costs = self._problem.costs(particles).numpy()
        states, inputs = particles.states.numpy(), particles.inputs.numpy()
        rows = states[:-1], inputs, states[1:], self._rewards(costs)
        flat = [array.reshape(costs.size, *array.shape[2:]) for array in rows]
        if not all(np.isfinite(array).all() for array in flat):
            raise InputError("The model predicts nothing finite; let its agent learn a trial more.")
        return Imagined(*flat)

    def _rewards(self, costs: Float[np.ndarray, "T P"]) -> Float[np.ndarray, "T P"]:
        if isinstance(self._cost, RewardCost):
            return self._cost.rewards.max() - costs * np.ptp(self._cost.rewards)
        return 1.0 - costs
