"""One episode on the system: what the agent does is recorded, what the env returns is checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from jaxtyping import Float

from mcpilco.data import Rollout
from mcpilco.typing import EnvError

OUTCOMES = ("is_success", "time_up_s", "mean_abs_cart_m")
"""entries of `info` that are kept as the env's own measures of an episode"""


def run_episode(
    env: gym.Env,
    act: Callable[[Float[np.ndarray, " X"]], Float[np.ndarray, " U"]],
    horizon: int,
    dt: float,
    seed: int | None = None,
    options: dict[str, Any] | None = None,
    width: int | None = None,
) -> Rollout:
    """Reset the env, act until the horizon or the end of the episode, and return the record.

    Args:
        env: a Gymnasium env with Box spaces.
        act: from an observation to an input in the env's unit; it is clipped to the action space.
        horizon: most steps.
        dt: sampling time [s], for the record.
        seed: passed to `env.reset`.
        options: passed to `env.reset`.
        width: X, of the true states that the env may tell; None: as wide as its observations.

    Raises:
        EnvError: the env returned a value that is not finite, or of another shape than its space.
    """
    space = env.action_space
    assert isinstance(space, gym.spaces.Box), "mcpilco.contract has checked it"
    shape = env.observation_space.shape
    observation, info = env.reset(seed=seed, options=options)
    observations = [_checked(observation, shape, "observation", 0)]
    infos: list[Mapping[str, Any]] = [info]
    inputs, rewards = [], []
    for step in range(1, horizon + 1):
        action = np.clip(act(observations[-1]), space.low, space.high).astype(space.dtype)
        observation, reward, terminated, truncated, info = env.step(action)
        observations.append(_checked(observation, shape, "observation", step))
        rewards.append(float(_checked(np.squeeze(np.asarray(reward)), (), "reward", step)))
        infos.append(info)
        inputs.append(action.astype(np.float64))
        if terminated or truncated:
            break
    return Rollout(
        dt=dt,
        observations=np.array(observations),
        inputs=np.array(inputs),
        rewards=np.array(rewards),
        states=_true_states(infos, shape if width is None else (width,)),
        outcome={key: float(info[key]) for key in OUTCOMES if key in info},
    )


def _true_states(
    infos: Sequence[Mapping[str, Any]], shape: tuple[int, ...] | None
) -> Float[np.ndarray, "T_plus_1 X"] | None:
    """`info["state"]` of each step; None where it is absent, or has another shape."""
    states = [info.get("state") for info in infos]
    if any(state is None or np.shape(state) != shape for state in states):
        return None
    return np.array([_checked(s, shape, 'info["state"]', step) for step, s in enumerate(states)])


def _checked(
    value: Any, shape: tuple[int, ...] | None, name: str, step: int
) -> Float[np.ndarray, "*b"]:
    """The value in float64, a copy."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        array = None
    if array is None or array.shape != shape or not np.isfinite(array).all():
        raise EnvError(
            f"The env must return finite numbers of shape {shape}, "
            f"got {name} {value!r} at step {step}; "
            "check its equations, its sensor, or the action it was given."
        )
    return array
