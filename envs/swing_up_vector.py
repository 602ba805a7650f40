"""Episodes of a swing-up, many at a time: the Gymnasium vector env of any system."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Bool, Float, UInt8

from envs.swing_up import read_start
from envs.swing_up_env import SwingUpEnv
from mcpilco.typing import InputError


class SwingUpVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """`num_envs` systems in one batch, all arithmetic on arrays; else as the single env.

    An episode is truncated after `max_episode_steps`; the next `step` ignores that system's action
    and starts a new episode, with reward 0 (Gymnasium's next-step autoreset). One generator, seeded
    by `reset(seed=...)`, draws for all. `reset(options={"state": x})` takes one state for all, or
    one for each. Infos are arrays over the batch, each with its mask `_key`, as Gymnasium has it.
    """

    metadata: dict[str, Any] = {
        "render_modes": ["rgb_array"],
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(self, single: SwingUpEnv, num_envs: int, max_episode_steps: int | None) -> None:
        """A batch of envs with the same physics.

        Args:
            single: the env to make many of.
            num_envs: how many.
            max_episode_steps: steps after which an episode is truncated; None never does.

        Raises:
            InputError: a number is no count.
        """
        _require_count("num_envs", num_envs)
        if max_episode_steps is not None:
            _require_count("max_episode_steps", max_episode_steps)
        self.num_envs = num_envs
        self.render_mode = single.render_mode
        self.metadata = {**self.metadata, "render_fps": single.metadata["render_fps"]}
        self.single_observation_space = single.observation_space
        self.single_action_space = single.action_space
        self.observation_space = batch_space(single.observation_space, num_envs)
        self.action_space = batch_space(single.action_space, num_envs)
        self.swing_up, self.task, self.scene = single.swing_up, single.task, single.scene
        self.picture = single.picture
        self._last_step = np.inf if max_episode_steps is None else max_episode_steps
        self._judge = self.swing_up.judge(num_envs)
        self._motion = self.swing_up.motion(num_envs)
        self._inputs = np.zeros(num_envs)
        self._steps = np.zeros(num_envs, dtype=int)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float[np.ndarray, "B Y"], dict[str, Any]]:
        """Starts all episodes; arguments, returns and errors as in `SwingUpEnv.reset`."""
        super().reset(seed=seed)
        width = self.swing_up.width
        states = read_start(options, (width,), (self.num_envs, width))
        self._restart(np.ones(self.num_envs, dtype=bool), states)
        return self.swing_up.observe(self._motion, self.np_random), self._infos()

    def step(
        self, actions: Float[np.ndarray, "B 1"]
    ) -> tuple[
        Float[np.ndarray, "B Y"],
        Float[np.ndarray, " B"],
        Bool[np.ndarray, " B"],
        Bool[np.ndarray, " B"],
        dict[str, Any],
    ]:
        """Holds the inputs `actions`, in their unit, for dt; starts anew what was truncated."""
        over = self._steps >= self._last_step
        self._inputs = self.swing_up.inputs(actions, self.num_envs)
        samples = self._motion.advance(self._inputs)
        self._steps += 1
        self._judge.watch(samples)
        rewards = self.swing_up.reward(samples[-1], self._inputs)
        if over.any():
            rewards[over] = 0.0
            self._restart(over)
        return (
            self.swing_up.observe(self._motion, self.np_random),
            rewards,
            np.zeros(self.num_envs, dtype=bool),
            self._steps >= self._last_step,
            self._infos(),
        )

    def render(self) -> tuple[UInt8[np.ndarray, "H W 3"], ...] | None:
        """A picture of each system, or None without `render_mode="rgb_array"`."""
        if self.render_mode is None:
            return None
        pushes = self._inputs / self.swing_up.input_limit
        return tuple(
            self.picture(state, push)
            for state, push in zip(self._motion.states, pushes, strict=True)
        )

    def _restart(
        self, which: Bool[np.ndarray, " B"], states: Float[np.ndarray, "*b X"] | None = None
    ) -> None:
        """Starts new episodes of the systems marked, in the states given or in random ones."""
        if states is None:
            states = self.swing_up.start(self.np_random, int(which.sum()))
        self._motion.restart(which, np.broadcast_to(states, (which.sum(), states.shape[-1])))
        self._inputs[which] = 0.0
        self._steps[which] = 0
        self._judge.restart(which)

    def _infos(self) -> dict[str, Any]:
        infos = {"state": self._motion.states, **self._judge.verdict()}
        masks = {f"_{key}": np.ones(self.num_envs, dtype=bool) for key in infos}
        return {**infos, **masks}


def _require_count(name: str, value: Any) -> None:
    if not (isinstance(value, int | np.integer) and value >= 1):
        raise InputError(f"{name} must be an integer of at least 1, got {value!r}.")
