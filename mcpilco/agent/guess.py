"""Guesses the task of an env that shows none: by its class, its MuJoCo model, or its names."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np
from jaxtyping import Float

from mcpilco.policies import SaturatingCost, TipCost
from mcpilco.sensing import TURN, state_of
from mcpilco.task import TaskSpec

RESETS = 50
"""resets that the distribution of the start is measured from; they cost no step"""


@dataclass(frozen=True)
class Guess:
    """A guessed task, and the evidence for it."""

    task: TaskSpec
    """with the start measured; its cost is None where it must be learned"""
    source: str
    """the evidence, for a sentence"""

    def __str__(self) -> str:
        task = self.task
        angles = ", ".join(task.state_names[i] for i in task.angles) or "none"
        pairs = ", ".join(
            f"{task.state_names[v]} of {task.state_names[p]}" for p, v in task.velocities
        )
        cost = "learned from the rewards" if task.cost is None else str(task.cost)
        return (
            f"The task is guessed from {self.source}: states {', '.join(task.state_names)}; "
            f"angles {angles}; velocities {pairs or 'none'}; dt {task.dt:g} s; cost {cost}; "
            f"start measured from {RESETS} resets. Give a task file (--task) if this is wrong."
        )


def guess_task(env: gym.Env) -> Guess | None:
    """The task of an env, as far as it can be guessed; None where it cannot.

    The env is reset, from seeds of its own, to see where episodes start.
    """
    for source, guessed in SOURCES:
        task = guessed(env)
        if task is not None:
            return Guess(with_measured_start(env, task), source)
    return None


def with_measured_start(env: gym.Env, task: TaskSpec) -> TaskSpec:
    """The task, with mean and standard deviation of the start as `RESETS` resets show them."""
    states = state_of(task, np.array([env.reset(seed=seed)[0] for seed in range(RESETS)], float))
    mean, std = start_of(states, task.angles)
    return replace(task, start_mean=tuple(mean.tolist()), start_std=tuple(std.tolist()))


def start_of(
    states: Float[np.ndarray, "N X"], angles: Sequence[int]
) -> tuple[Float[np.ndarray, " X"], Float[np.ndarray, " X"]]:
    """Mean and standard deviation of states at reset, those of angles around the circle."""
    states, columns = states.copy(), list(angles)
    around = states[:, columns]
    centre = np.arctan2(np.sin(around).mean(0), np.cos(around).mean(0))
    states[:, columns] = around - TURN * np.round((around - centre) / TURN)
    return states.mean(0), states.std(0)


# --- by the class ---------------------------------------------------------------------------------


def _pendulum(env: Any) -> TaskSpec:
    # its velocity is updated first and its angle from that: not the mean velocity of eq. (5.9), so
    # the angle has a model of its own
    return _task(
        {"angle": "rad", "velocity": "rad/s"},
        {"torque": "N m"},
        dt=env.dt,
        angles=(0,),
        velocities=(),
        observed=((0, 1), 2),
        cost=TipCost((0,), (1.0,), lengthscale=1.0),
        goal=(0.0,) * 2,
    )


def _inverted_pendulum(env: Any) -> TaskSpec:
    cost = SaturatingCost((0, 1), (0.0, 0.0), (0.5, 0.2), (False, False))
    task = _mujoco_task(env)
    assert task is not None, "its observation is qpos and qvel"
    return replace(task, cost=cost, goal=(0.0,) * 4)


def _inverted_double_pendulum(env: Any) -> TaskSpec:
    units = {"cart_position": "m", "pole_angle": "rad", "second_pole_angle": "rad"}
    rates = {"cart_velocity": "m/s", "pole_velocity": "rad/s", "second_pole_velocity": "rad/s"}
    return _task(
        units | rates,
        {"control": "-"},
        dt=env.dt,
        angles=(1, 2),
        velocities=((0, 3), (1, 4), (2, 5)),
        observed=(0, (3, 1), (4, 2), 5, 6, 7),  # 8, a force of the rail's end, is left out
        cost=TipCost((1, 2), (0.6, 0.6), lengthscale=0.3, foot=0),
        goal=(0.0,) * 6,
    )


CLASSES: dict[str, Callable[[Any], TaskSpec]] = {
    "gymnasium.envs.classic_control.pendulum:PendulumEnv": _pendulum,
    "gymnasium.envs.mujoco.inverted_pendulum_v5:InvertedPendulumEnv": _inverted_pendulum,
    "gymnasium.envs.mujoco.inverted_double_pendulum_v5:InvertedDoublePendulumEnv": (
        _inverted_double_pendulum
    ),
}
"""Gymnasium's envs that are known, by module and class"""


def _known_class(env: gym.Env) -> TaskSpec | None:
    kind = type(env.unwrapped)
    make = CLASSES.get(f"{kind.__module__}:{kind.__name__}")
    return None if make is None else make(env.unwrapped)


# --- by the model ---------------------------------------------------------------------------------


def _mujoco_task(env: Any) -> TaskSpec | None:
    """The task of an env that observes [qpos, qvel] of a MuJoCo model with single-axis joints."""
    model, data = getattr(env, "model", None), getattr(env, "data", None)
    if model is None or data is None or getattr(model, "nq", None) != getattr(model, "nv", 0):
        return None
    observation, _ = env.reset(seed=0)
    state = np.concatenate([data.qpos, data.qvel])
    if np.shape(observation) != state.shape or not np.allclose(observation, state):
        return None
    joints = [model.joint(i) for i in range(model.njnt)]
    hinges = [int(joint.type[0]) == _HINGE for joint in joints]
    names = [joint.name or f"joint_{i}" for i, joint in enumerate(joints)]
    units = {n: ("rad" if hinge else "m") for n, hinge in zip(names, hinges, strict=True)}
    return _task(
        units | {f"{name}_velocity": f"{unit}/s" for name, unit in units.items()},
        {model.actuator(i).name or f"control_{i}": "-" for i in range(model.nu)},
        dt=float(env.dt),
        angles=tuple(i for i, hinge in enumerate(hinges) if hinge),
        velocities=tuple((i, model.nq + i) for i in range(model.nq)),
    )


_HINGE = 3  # mujoco.mjtJoint.mjJNT_HINGE; free and ball joints have other widths, so nq != nv


# --- by the names ---------------------------------------------------------------------------------

_ANGLE = re.compile(r"(?:^|_)(?:angle|theta|phi|psi)\d*$")
_VELOCITY = re.compile(r"^d(\w+)$|^(\w+?)_(?:velocity|vel|dot|speed|rate)$")
_CIRCULAR = re.compile(r"^(cos|sin)[_(]?(\w+?)\)?$|^(\w+)_(cos|sin)$")


def _by_names(env: gym.Env) -> TaskSpec | None:
    """The task of an env that names its observations in `observation_names`, and tells its dt."""
    inner: Any = env.unwrapped
    names = tuple(getattr(inner, "observation_names", ()))
    dt = getattr(inner, "dt", None) or 1.0 / env.metadata.get("render_fps", np.inf)
    if env.observation_space.shape != (len(names),) or not dt:
        return None
    columns = states_named(names)
    circular = [isinstance(column, tuple) for column in columns.values()]
    is_angle = zip(columns, circular, strict=True)
    return _task(
        dict.fromkeys(columns, "-"),
        {f"input_{i}": "-" for i in range((env.action_space.shape or (0,))[0])},
        dt=float(dt),
        angles=tuple(i for i, (name, pair) in enumerate(is_angle) if pair or _ANGLE.search(name)),
        velocities=velocities_named(list(columns)),
        observed=tuple(columns.values()) if any(circular) else (),
    )


def states_named(names: Sequence[str]) -> dict[str, int | tuple[int, int]]:
    """Where each state is observed, cosines and sines of one name joined to its angle."""
    found: dict[str, dict[str, int]] = {}
    for i, name in enumerate(names):
        match = _CIRCULAR.match(name)
        if match:
            kind, stem = (match[1], match[2]) if match[1] else (match[4], match[3])
            found.setdefault(stem, {})[kind] = i
    pairs = {stem: parts for stem, parts in found.items() if len(parts) == 2}
    columns: dict[str, int | tuple[int, int]] = {}
    for i, name in enumerate(names):
        stem = next((stem for stem, parts in pairs.items() if i in parts.values()), None)
        columns[stem or name] = (pairs[stem]["cos"], pairs[stem]["sin"]) if stem else i
    return columns


def velocities_named(names: Sequence[str]) -> tuple[tuple[int, int], ...]:
    """Pairs (position, velocity) of names like `pole_angle` and `pole_velocity`, `x` and `dx`."""
    pairs = []
    for velocity, name in enumerate(names):
        match = _VELOCITY.match(name)
        stem = (match[1] or match[2]) if match else None
        if stem is None:
            continue
        for position in (stem, f"{stem}_position", f"{stem}_angle"):
            if position in names:
                pairs.append((names.index(position), velocity))
                break
    return tuple(pairs)


def _task(states: dict[str, str], inputs: dict[str, str], *, dt: float, **entries: Any) -> TaskSpec:
    zeros = (0.0,) * len(states)
    moves, acts = (tuple(states), tuple(states.values())), (tuple(inputs), tuple(inputs.values()))
    return TaskSpec(*moves, *acts, dt, start_mean=zeros, start_std=zeros, **entries)


SOURCES: tuple[tuple[str, Callable[[gym.Env], TaskSpec | None]], ...] = (
    ("its class, which is known", _known_class),
    ("its MuJoCo model", lambda env: _mujoco_task(env.unwrapped)),
    ("its observation_names", _by_names),
)
"""ways to tell a task, the surest first, and what they look at"""
