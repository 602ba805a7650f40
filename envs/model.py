"""Any MuJoCo model as an environment: the file says what moves, keywords say what it is to do."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import torch
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from jaxtyping import Float, UInt8

from envs.checks import read_array, read_stds, require_positive
from envs.motion import Motion
from envs.mujoco_views import ModelPicture, Posture, scene
from envs.swing_up import Effects, read_effects, read_start
from mcpilco.mjcf import MujocoPlant, SteppedModel, load_mjcf, read_plant
from mcpilco.plant import ChainPlant, Plant, corrected
from mcpilco.policies import SaturatingCost
from mcpilco.task import TaskSpec
from mcpilco.typing import EnvError, InputError

GOAL = "target", "lengthscale", "magnitude"
"""entries of a state in the keyword `cost`"""


class ModelEnv(gym.Env[np.ndarray, np.ndarray]):
    """A MuJoCo model, and a goal for its states.

    ## Description

    The model is an MJCF or URDF file of hinges and slides. Where equations of motion can say it
    they move it, else MuJoCo does, contacts, tendons and servos included; which of both is printed
    by `mcpilco gap --plant FILE`. The id is `mcpilco/Model-v0`.

    ## Action Space

    A `Box`: the command of each actuator, in the model's order, between the ends of its
    `ctrlrange`. A command beyond them is clipped; NaN is an error.

    ## Observation Space

    A `Box` of shape (X,), float64: `<joint>_position` and `<joint>_velocity` of each joint, in the
    model's order [rad, rad/s or m, m/s], measured with independent Gaussian noise. `info["state"]`
    is the true state.

    ## Rewards

    1 - cost of the true state after the step, with the cost in [0, 1]

        cost = 1 - exp( -sum_i ((x_i - target_i) / lengthscale_i)^2 )

    over the states that `cost` names; with `magnitude`, |x_i| stands for x_i.

    ## Starting State

    Independent Gaussians. `reset(options={"state": x})` starts exactly in x.

    ## Episode End

    The episode never terminates, and is not truncated: give a horizon.

    ## Arguments

    | Keyword       | Meaning                                            | Default  | Unit  |
    |---------------|----------------------------------------------------|----------|-------|
    | `model`       | path of the MJCF or URDF file                      |          |       |
    | `cost`        | by state: `target`, `lengthscale`, and `magnitude` |          | state |
    | `dt`          | time for which a command is held                   | 0.05     | s     |
    | `start_mean`  | by state, the others as the model is drawn         | as drawn | state |
    | `start_std`   | spread of the start, one number or one a state     | 0.01     | state |
    | `noise_std`   | measurement noise, likewise                        | 0.01     | state |
    | `input_limit` | by actuator, of one without a `ctrlrange`          | {}       | its   |
    | `keyframe`    | name of the pose that stands for the one drawn     | ""       |       |
    | `effects`     | what the model lacks, as `gap/corrected.json`      | None     |       |
    | `render_mode` | None or `"rgb_array"`                              | None     |       |

    A wrong value raises `mcpilco.typing.InputError`.

    ## Version History

    - v0: first version.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 20}

    def __init__(
        self,
        model: str | Path,
        cost: Mapping[str, Mapping[str, Any]],
        dt: float = 0.05,
        start_mean: Mapping[str, float] | None = None,
        start_std: float | tuple[float, ...] = 0.01,
        noise_std: float | tuple[float, ...] = 0.01,
        input_limit: Mapping[str, float] | None = None,
        keyframe: str = "",
        effects: Effects | None = None,
        render_mode: str | None = None,
    ) -> None:
        """The keywords are those under Arguments."""
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(f'render_mode must be None or "rgb_array", got {render_mode!r}.')
        require_positive("dt", dt, "s")
        compiled = load_mjcf(Path(model), "model must be an MJCF or a URDF file")
        plant = read_plant(model, keyframe=keyframe)
        if plant.layout.orientations:
            raise InputError(
                f"{plant.name} must have hinges and slides alone, whose positions are numbers; it "
                "has a free or a ball joint."
            )
        if effects is not None:
            plant = corrected(plant, read_effects(effects))
        states = plant.layout.states
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": max(1, round(1.0 / dt))}
        self.plant = plant if isinstance(plant, ChainPlant) else None
        self.task = TaskSpec(
            state_names=states,
            state_units=plant.layout.units,
            input_names=plant.layout.inputs,
            input_units=tuple(plant.layout.unit_of(a)[1] for a in plant.layout.actuators),
            dt=dt,
            angles=plant.angles,
            velocities=tuple((q, q + 1) for q in range(0, len(states), 2)),
            start_mean=_by_state("start_mean", start_mean or {}, states, plant.rest),
            start_std=read_stds("start_std", start_std, len(states)),
            cost=cost_of(cost, states),
        )
        goal = _goal(self.task)
        if not goal[1::2].any():
            self.task = replace(self.task, goal=tuple(goal.tolist()))
        self._noise = np.array(read_stds("noise_std", noise_std, len(states)))
        bound = float(np.finfo(np.float32).max)
        self.observation_space = Box(-bound, bound, (len(states),), np.float64)
        self._range = _ranges(plant, compiled, input_limit or {})
        self.action_space = Box(*self._range, dtype=np.float64)
        self._motion = motion_of(plant, dt)
        self._running = False
        posture = Posture(compiled, plant.layout.joints, "tip")
        self.scene = scene(posture, goal)
        self.picture = ModelPicture(posture)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float[np.ndarray, " X"], dict[str, Any]]:
        """Starts an episode; `options={"state": x}` exactly in x.

        Raises:
            InputError: an unknown option, or a state that is not finite numbers, one for each.
        """
        super().reset(seed=seed)
        state = read_start(options, self._noise.shape)
        if state is None:
            spread = np.array(self.task.start_std) * self.np_random.standard_normal(
                len(self._noise)
            )
            state = np.array(self.task.start_mean) + spread
        self._motion.restart(True, state)
        self._running = True
        return self._measured(), {"state": self._motion.states}

    def step(
        self, action: Float[np.ndarray, " U"]
    ) -> tuple[Float[np.ndarray, " X"], float, bool, bool, dict[str, Any]]:
        """Holds the commands for dt: the measured state, the reward, False, False, and `info`.

        Raises:
            InputError: NaN, or another shape than (U,).
            EnvError: the motion runs away.
        """
        self._require_running()
        held = read_array("action", action, self.action_space.shape or ())
        held = np.clip(held, *self._range)
        state = self._motion.advance(held)[-1]
        assert self.task.cost is not None, "the keyword is required"
        cost = self.task.cost(torch.as_tensor(state), torch.as_tensor(held))
        return self._measured(), 1.0 - float(cost), False, False, {"state": state}

    def render(self) -> UInt8[np.ndarray, "H W 3"] | None:
        """A picture of the true state, or None without `render_mode="rgb_array"`."""
        if self.render_mode is None:
            gym.logger.warn('render() draws nothing; make the env with render_mode="rgb_array".')
            return None
        self._require_running()
        return self.picture(self._motion.states)

    def close(self) -> None:
        """Gives OpenGL back; the env can still be used."""
        self.picture.close()

    def _measured(self) -> Float[np.ndarray, " X"]:
        return self._motion.measured + self._noise * self.np_random.standard_normal(
            len(self._noise)
        )

    def _require_running(self) -> None:
        if not self._running:
            raise ResetNeeded("The env has no state yet; call reset() first.")


class ModelMotion(Motion):
    """A motion of a model that MuJoCo steps, with the effects of its plant."""

    def __init__(self, plant: MujocoPlant, dt: float) -> None:
        """In the state 0, of commands that are held for dt [s]."""
        self._stepped = SteppedModel(plant, dt)

    @property
    def states(self) -> Float[np.ndarray, " X"]:
        return self._stepped.state

    measured = states

    def restart(self, which: Any, states: Float[np.ndarray, " X"]) -> None:
        self._stepped.restart(states)

    def advance(self, inputs: Float[np.ndarray, " U"]) -> Float[np.ndarray, "1 X"]:
        before = self.states
        state = self._stepped.advance(inputs)
        if not np.isfinite(state).all():
            raise EnvError(
                f"MuJoCo calls the motion from the state {before.tolist()} unstable; the state or "
                "the command is too large, or the model's timestep too long."
            )
        return state[None]


def motion_of(plant: Plant, dt: float) -> Motion:
    """The motion of a plant, by its equations or by MuJoCo.

    Raises:
        InputError: MuJoCo simulates it, and it has effects of sensors.
    """
    if isinstance(plant, ChainPlant):
        return Motion(plant, dt, 1, ())
    assert isinstance(plant, MujocoPlant)
    if seen := [str(active) for active, _ in plant.added if active.effect.place == "sensor"]:
        raise InputError(
            f"effects must move {plant.name}, which MuJoCo simulates, got {', '.join(seen)}: apply "
            "effects of sensors to the observations, with a wrapper."
        )
    return ModelMotion(plant, dt)


def cost_of(goals: Mapping[str, Mapping[str, Any]], states: tuple[str, ...]) -> SaturatingCost:
    """The cost over the states that are named, with a target and a lengthscale each.

    Raises:
        InputError: there is none, an unknown state or entry, or no number.
    """
    example = '{"pole_position": {"target": 3.14, "lengthscale": 1.0, "magnitude": true}}'
    whole = isinstance(goals, Mapping) and all(isinstance(g, Mapping) for g in goals.values())
    if not (goals and whole):
        raise InputError(f"cost must give states a goal, such as {example}, got {goals!r}.")
    _require_known("cost", goals, states)
    for name, goal in goals.items():
        _require_known(f"cost of {name}", goal, GOAL)
        if "lengthscale" not in goal:
            raise InputError(f"cost of {name} must have a lengthscale, got {dict(goal)}.")
    chosen = [(states.index(name), goal) for name, goal in goals.items()]
    return SaturatingCost(
        tuple(index for index, _ in chosen),
        tuple(float(read_array("target", goal.get("target", 0.0), ())) for _, goal in chosen),
        tuple(float(read_array("lengthscale", goal["lengthscale"], ())) for _, goal in chosen),
        tuple(bool(goal.get("magnitude", False)) for _, goal in chosen),
    )


def _goal(task: TaskSpec) -> Float[np.ndarray, " X"]:
    """The state where episodes start, moved to the targets of the cost."""
    goal = np.array(task.start_mean)
    assert isinstance(task.cost, SaturatingCost)
    goal[list(task.cost.components)] = task.cost.targets
    return goal


def _by_state(
    name: str, given: Mapping[str, float], states: tuple[str, ...], usual: Float[np.ndarray, " X"]
) -> tuple[float, ...]:
    """A number for each state: the one given, or the usual one."""
    _require_known(name, given, states)
    values = dict(zip(states, usual.tolist(), strict=True))
    for state, value in given.items():
        values[state] = float(read_array(f"{name} of {state}", value, ()))
    return tuple(values.values())


def _ranges(
    plant: Plant, model: mujoco.MjModel, limits: Mapping[str, float]
) -> tuple[Float[np.ndarray, " U"], Float[np.ndarray, " U"]]:
    """Smallest and largest command of each actuator."""
    names = plant.layout.inputs
    _require_known("input_limit", limits, names)
    low, high = np.full(len(names), -math.inf), np.full(len(names), math.inf)
    for u, name in enumerate(names):
        with contextlib.suppress(KeyError):
            if model.actuator(name).ctrllimited[0]:
                low[u], high[u] = model.actuator(name).ctrlrange
        if name in limits:
            require_positive(f"input_limit of {name}", limits[name], "its unit")
            low[u], high[u] = max(low[u], -limits[name]), min(high[u], limits[name])
    if unbounded := [name for name, top in zip(names, high, strict=True) if math.isinf(top)]:
        raise InputError(
            f"Each actuator must have a ctrlrange in {plant.name}, or an input_limit, such as "
            f'{{"{unbounded[0]}": 1.0}}; {", ".join(unbounded)} has none.'
        )
    return low, high


def _require_known(what: str, given: Mapping[str, Any], known: tuple[str, ...]) -> None:
    if unknown := [name for name in given if name not in known]:
        raise InputError(f"{what} knows {', '.join(known)}, got {', '.join(map(repr, unknown))}.")
