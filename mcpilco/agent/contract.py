"""The demands of an agent on an env, and the sentences that say which are not met."""

from __future__ import annotations

import logging
import sys
from typing import Any, NoReturn

import gymnasium as gym
import numpy as np
import torch
from gymnasium.envs.registration import EnvSpec
from gymnasium.spaces import Box
from jaxtyping import Float
from torch import Tensor

from mcpilco.agent.algorithms import names_in, require_imported
from mcpilco.agent.guess import guess_task
from mcpilco.config import LONGEST, SearchConfig
from mcpilco.policies import RewardCost
from mcpilco.task import TaskSpec
from mcpilco.typing import EnvError, InputError, McPilcoError

logger = logging.getLogger(__name__)


def make_env(env: gym.Env | str, **kwargs: Any) -> gym.Env:
    """The env itself, or the one registered under an id; of `module:Id` nothing is imported.

    Nor is it where a keyword holds such a name, as those of envs that wrap another may.

    Raises:
        EnvError: no such id, its module has not been imported, its constructor refuses the
            keywords, or no single Gymnasium env.
    """
    if isinstance(env, gym.Env):
        return env
    if not isinstance(env, str):
        raise EnvError(
            f"An agent needs one gymnasium.Env or the id of one, got {type(env).__name__}; "
            "it learns in a single env, without a vector of them."
        )
    try:
        for name in (env, *names_in(kwargs)):
            require_imported(name)
        made = gym.make(env, **kwargs)
    except Exception as error:  # a constructor is foreign code
        known = "envs" in sys.modules or not env.startswith("mcpilco/")
        remedy = "" if known else " Write `import envs` first: it registers this package's envs."
        raise EnvError(f"Cannot make the env {env!r}: {error}{remedy}") from error
    if (mujoco := sys.modules.get("mujoco")) is not None:  # else it writes MUJOCO_LOG.TXT here
        mujoco.set_mju_user_warning(logger.warning)
    return made


def task_of(env: gym.Env, task: TaskSpec | None, quiet: bool = False) -> TaskSpec:
    """The task given, or the one that the env shows, or one that is guessed, with a warning.

    A given task comes before the env's; `quiet` guesses without a warning.

    Raises:
        EnvError: there is none and none can be guessed, or it does not match the env's spaces.
        InputError: the one that is given is none.
    """
    _check_kind(env, env.observation_space, "observation")
    _check_kind(env, env.action_space, "action")
    if not isinstance(task, TaskSpec | None):
        raise InputError(f"task must be a mcpilco.task.TaskSpec, got {task!r:.80}.")
    if task is None:
        task = getattr(env.unwrapped, "task", None)
    if task is None:
        guess = guess_task(env)
        if guess is not None:
            logger.log(logging.DEBUG if quiet else logging.WARNING, "%s", guess)
            task = guess.task
    if not isinstance(task, TaskSpec):
        shows = "no attribute `task`" if task is None else f"a `task` of type {type(task).__name__}"
        raise EnvError(
            f"{_name(env)} shows {shows}. Give it a mcpilco.task.TaskSpec that names its states, "
            "angles, velocities, start and cost, or pass one as MCPILCO(..., task=...), "
            "on the command line in a file, --task FILE."
        )
    if not task.observed:
        _check_width(env, env.observation_space, "observation", len(task.measured_states))
    _check_observed(env, task)
    _check_width(env, env.action_space, "action", len(task.input_names))
    return task


def input_bounds(env: gym.Env) -> tuple[Float[np.ndarray, " U"], Float[np.ndarray, " U"]]:
    """Smallest and largest inputs, in the env's unit.

    Raises:
        EnvError: the action space is unbounded, or empty.
    """
    space = env.action_space
    assert isinstance(space, Box), "task_of has checked it"
    low, high = space.low.astype(np.float64), space.high.astype(np.float64)
    if not (np.isfinite(low).all() and np.isfinite(high).all() and (low < high).all()):
        raise EnvError(
            f"{_name(env)} must have finite action bounds, low < high, "
            f"got low {low.tolist()}, high {high.tolist()}; "
            "bound them, for example with gymnasium.wrappers.TransformAction."
        )
    return low, high


def check_cost(task: TaskSpec, low: Float[np.ndarray, " U"], high: Float[np.ndarray, " U"]) -> None:
    """Call the cost as a policy search does: of particles where episodes start, with a gradient.

    A cost that is learned from rewards is not looked at.
    """
    if task.cost is None or isinstance(task.cost, RewardCost):
        return
    rng, X = np.random.default_rng(0), len(task.state_names)
    shape = (X + 2, X + 3)  # of steps and particles: no axis is as long as a state
    start = rng.normal(task.start_mean, np.maximum(task.start_std, 1e-3), (*shape, X))
    states = torch.from_numpy(start)
    inputs = torch.from_numpy(rng.uniform(low, high, (*shape, len(low))))
    if wrong := _wrong_cost(task, states, inputs):
        raise EnvError(
            f"The task's cost must give one finite number for each particle: of states "
            f"{tuple(states.shape)} and inputs {tuple(inputs.shape)} a tensor {shape}; {wrong}."
        )


def _wrong_cost(task: TaskSpec, states: Tensor, inputs: Tensor) -> str | None:
    """The fault of the cost of these particles, and what to do about it; None: it has none."""
    assert task.cost is not None, "check_cost has seen to it"
    particles = states.requires_grad_(), inputs.requires_grad_()
    try:
        costs: Any = task.cost(*particles)
    except McPilcoError:
        raise
    except Exception as error:  # a user's function
        return (
            f"it raised {type(error).__name__}: {error}. Write it with torch functions of the "
            f"{len(task.state_names)} states in the last axis: "
            f"states[..., 0] is {task.state_names[0]}"
        )
    if not isinstance(costs, Tensor) or not costs.is_floating_point():
        return f"got {costs!r:.80}. Write it with torch functions of states and inputs"
    if costs.shape != states.shape[:-1]:
        return (
            f"got shape {tuple(costs.shape)}. Index and sum over the last axis alone, as in "
            "states[..., 0] and .sum(-1)"
        )
    if not costs.isfinite().all():
        return "got numbers that are not finite where episodes start. Mend its formula there"
    if not costs.requires_grad:
        return (
            "got a number without gradient. Write it with torch functions of states and inputs, "
            "without numpy, .detach(), .item() or torch.no_grad()"
        )
    slopes = torch.autograd.grad(costs.sum(), particles, allow_unused=True)
    if not all(slope is None or slope.isfinite().all() for slope in slopes):
        return (
            "got a gradient that is not finite where episodes start. Keep roots and quotients away "
            "from zero, as in (x**2 + 1e-6).sqrt()"
        )
    return None


def time_limit(env: gym.Env) -> int | None:
    """Steps after which the env truncates an episode; None: never."""
    return None if env.spec is None else env.spec.max_episode_steps


def horizon_of(env: gym.Env, horizon: int | None) -> int:
    """Steps of one episode: as configured, or the env's time limit.

    Raises:
        InputError: neither is known, the env ends sooner than configured, or an episode would be
            longer than `LONGEST`.
    """
    limit = time_limit(env)
    steps = limit if horizon is None else horizon
    if steps is None:
        raise InputError(
            f"{_name(env)} has no time limit; pass a horizon in steps, duration / dt, "
            "on the command line --horizon."
        )
    if steps > LONGEST:
        numbers = sum(int(np.prod(s.shape or 1)) for s in (env.observation_space, env.action_space))
        size = steps * numbers * SearchConfig().particles * np.float64().nbytes
        raise InputError(
            f"horizon must be at most {LONGEST} steps, got {steps}: all steps of all particles are "
            f"kept at once, which would take about {size / 1e9:.3g} GB; lengthen the env's dt, or "
            "learn from shorter episodes."
        )
    if limit is not None and steps > limit:
        raise InputError(
            f"horizon must not exceed the env's time limit of {limit} steps, got {steps}; "
            "make the env with a larger max_episode_steps."
        )
    return steps


class AbsentEnv(gym.Env[np.ndarray, np.ndarray]):
    """Stands for the env of an agent that was loaded without one: spaces and a task, no system."""

    def __init__(
        self,
        task: TaskSpec,
        low: Float[np.ndarray, " U"],
        high: Float[np.ndarray, " U"],
        horizon: int,
        width: int | None = None,
    ) -> None:
        """An env to ask for names and bounds.

        Without `width` it observes as many numbers as are measured.
        """
        self.task = task
        width = len(task.measured_states) if width is None else width
        self.observation_space = Box(-np.inf, np.inf, (width,), np.float64)
        self.action_space = Box(low, high, dtype=low.dtype.type)
        self.spec = EnvSpec("Absent-v0", max_episode_steps=horizon)

    def reset(self, **_: Any) -> NoReturn:
        """Not possible.

        Raises:
            EnvError: always.
        """
        raise EnvError(
            "The agent was loaded without an env, so it can predict but not learn; "
            "pass the env: MCPILCO.load(path, env)."
        )


def _check_kind(env: gym.Env, space: gym.Space, kind: str) -> None:
    """Raises EnvError unless the space is a vector of real numbers."""
    real = kind == "observation" or np.issubdtype(space.dtype, np.floating)
    if isinstance(space, Box) and len(space.shape) == 1 and real:
        return
    if kind == "action":
        remedy = "inputs are real numbers here: take an env whose actions are forces or torques"
    elif len(space.shape or ()) > 1:
        remedy = "images and tables are no state: let the env observe positions and velocities"
    else:
        remedy = "flatten it, with gymnasium.wrappers.FlattenObservation, where it holds the state"
    raise EnvError(
        f"{_name(env)} must have a one-dimensional Box {kind} space, got {space}; {remedy}."
    )


def _check_width(env: gym.Env, space: gym.Space, kind: str, count: int) -> None:
    """Raises EnvError unless the space is as wide as the task says."""
    if space.shape != (count,):
        raise EnvError(
            f"{_name(env)}'s task names {count} {kind}s, its {kind} space has shape {space.shape}."
        )


def _check_observed(env: gym.Env, task: TaskSpec) -> None:
    """Raises EnvError where the task looks for a state beyond the observation."""
    width = int(np.prod(env.observation_space.shape or (0,)))
    sources = [i for where in task.observed for i in np.atleast_1d(where).tolist()]
    if sources and max(sources) >= width:
        raise EnvError(
            f"{_name(env)}'s task finds a state in observation {max(sources)}, counted from 0, "
            f"its observation has {width} numbers."
        )


def name_of(env: gym.Env) -> str:
    """The id of an env, or the name of its class where it is not registered."""
    return type(env.unwrapped).__name__ if env.spec is None else env.spec.id


def _name(env: gym.Env) -> str:
    return f"The env {name_of(env)}"
