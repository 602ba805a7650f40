"""Episodes of a swing-up, one at a time: the Gymnasium env of any system."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from jaxtyping import Float, UInt8

from envs.swing_up import SwingUp, read_start
from mcpilco.show.scene import Scene
from mcpilco.typing import InputError

Picture = Callable[[Float[np.ndarray, " X"], float], UInt8[np.ndarray, "H W 3"]]
"""draws a state, and the input relative to its limit, in [-1, 1]"""


class SwingUpEnv(gym.Env[np.ndarray, np.ndarray]):
    """What the single envs have in common; each says in its docstring which system it is."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(
        self, swing_up: SwingUp, scene: Scene, picture: Picture, render_mode: str | None
    ) -> None:
        """An env without a state yet.

        Args:
            swing_up: the task.
            scene: what a state looks like in 3D.
            picture: what it looks like from the side.
            render_mode: None or "rgb_array".

        Raises:
            InputError: another render mode.
        """
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(f'render_mode must be None or "rgb_array", got {render_mode!r}.')
        self.swing_up = swing_up
        self.scene = scene
        self.picture = picture
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": max(1, round(1.0 / swing_up.dt))}
        self.observation_space = swing_up.observation_space
        self.action_space = swing_up.action_space
        self.task = swing_up.task
        self._judge = swing_up.judge()
        self._motion = swing_up.motion()
        self._state: Float[np.ndarray, " X"] | None = None
        self._input = 0.0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float[np.ndarray, " Y"], dict[str, Any]]:
        """Starts an episode.

        Args:
            seed: of the env's random numbers; None goes on with those it has.
            options: `{"state": x}` starts exactly in x, in the units of the states.

        Returns:
            The measured state and `info`.

        Raises:
            InputError: an unknown option, or a state that is not finite numbers, one for each.
        """
        super().reset(seed=seed)
        state = read_start(options, (self.swing_up.width,))
        self._state = self.swing_up.start(self.np_random) if state is None else state
        self._motion.restart(True, self._state)
        self._input = 0.0
        self._judge.restart()
        return self.swing_up.observe(self._motion, self.np_random), self._info()

    def step(
        self, action: Float[np.ndarray, " 1"]
    ) -> tuple[Float[np.ndarray, " Y"], float, bool, bool, dict[str, Any]]:
        """Holds the input `action`, in its unit, for dt.

        Returns:
            The measured state, the reward, False, False, and `info`.

        Raises:
            InputError: NaN, or another shape than (1,).
        """
        held = self.swing_up.inputs(action)
        self._started()
        samples = self._motion.advance(held)
        self._state, self._input = samples[-1], float(held)
        self._judge.watch(samples)
        reward = float(self.swing_up.reward(self._state, held))
        return (
            self.swing_up.observe(self._motion, self.np_random),
            reward,
            False,
            False,
            self._info(),
        )

    def render(self) -> UInt8[np.ndarray, "H W 3"] | None:
        """A picture of the true state, or None without `render_mode="rgb_array"`."""
        if self.render_mode is None:
            gym.logger.warn('render() draws nothing; make the env with render_mode="rgb_array".')
            return None
        return self.picture(self._started(), self._input / self.swing_up.input_limit)

    def _info(self) -> dict[str, Any]:
        verdict = {key: value.item() for key, value in self._judge.verdict().items()}
        return {"state": self._started().copy(), **verdict}

    def _started(self) -> Float[np.ndarray, " X"]:
        if self._state is None:
            raise ResetNeeded("The env has no state yet; call reset() first.")
        return self._state
