"""Episodes of a swing-up, one or many at a time: the Gymnasium envs of any system."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import load_env_creator
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Bool, Float, UInt8

from envs.drawing import side_view
from envs.swing_up import Effects, SwingUp, read_start
from mcpilco.plant import ChainPlant
from mcpilco.show import Scene, chain_scene
from mcpilco.typing import InputError

Picture = Callable[[Float[np.ndarray, " X"], float], UInt8[np.ndarray, "H W 3"]]
"""draws a state, and the input relative to its limit, in [-1, 1]"""


class SwingUpEnv(gym.Env[np.ndarray, np.ndarray]):
    """The single env of any system; subclasses say in their docstrings which one they are."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(
        self, swing_up: SwingUp, scene: Scene, picture: Picture, render_mode: str | None
    ) -> None:
        """An env without a state yet.

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
        self.plant = swing_up.plant if swing_up.engine is None else None
        self._judge = swing_up.judge()
        self._motion = swing_up.motion()
        self._state: Float[np.ndarray, " X"] | None = None
        self._inputs: Float[np.ndarray, " U"] = np.zeros(len(self.task.input_names))

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
        self._inputs = np.zeros_like(self._inputs)
        self._judge.restart()
        return self.swing_up.observe(self._motion, self.np_random), self._info()

    def step(
        self, action: Float[np.ndarray, " U"]
    ) -> tuple[Float[np.ndarray, " Y"], float, bool, bool, dict[str, Any]]:
        """Holds the inputs `action`, in their unit, for dt.

        Returns:
            The measured state, the reward, False, False, and `info`.

        Raises:
            InputError: NaN, or another shape than (U,).
        """
        held = self.swing_up.inputs(action)
        self._started()
        samples = self._motion.advance(held)
        self._state, self._inputs = samples[-1], held
        self._judge.watch(samples)
        reward = float(self.swing_up.reward(self._state, held))
        measured = self.swing_up.observe(self._motion, self.np_random)
        return measured, reward, False, False, self._info()

    def render(self) -> UInt8[np.ndarray, "H W 3"] | None:
        """A picture of the true state, or None without `render_mode="rgb_array"`."""
        if self.render_mode is None:
            gym.logger.warn('render() draws nothing; make the env with render_mode="rgb_array".')
            return None
        push = float(self._inputs[0]) / self.swing_up.input_limit
        return self.picture(self._started(), push)

    def _info(self) -> dict[str, Any]:
        verdict = {key: value.item() for key, value in self._judge.verdict().items()}
        return {"state": self._started().copy(), **verdict}

    def _started(self) -> Float[np.ndarray, " X"]:
        if self._state is None:
            raise ResetNeeded("The env has no state yet; call reset() first.")
        return self._state


class PlantEnv(SwingUpEnv):
    """An env that simulates its plant; a subclass sets `nominal`, and how it is drawn.

    Its keywords are those of `SwingUp.where`, and `render_mode`.

    `effects` corrects the env by what was found missing in it: a file such as `gap/corrected.json`,
    what such a file holds, or a `mcpilco.plant.correction.Correction`. The plant's constants are
    then the nominal ones. Friction, delays, play and the like act in the motion, effects of sensors
    on the observation, before its noise; `info["state"]` stays the true state, and the input of the
    cost the one that was asked for. Before an episode the motor was off.
    """

    nominal: ClassVar[SwingUp]
    """the plant and the task, with their default numbers"""

    def __init__(
        self, *, effects: Effects | None = None, render_mode: str | None = None, **keywords: Any
    ) -> None:
        """The keywords are listed in the docstrings of the envs under Arguments."""
        swing_up = self.nominal.where(effects, **keywords)
        scene = self.scene_of(swing_up.plant)
        picture = partial(self.picture_of, swing_up.plant, scene)
        super().__init__(swing_up, scene, picture, render_mode)

    @staticmethod
    def scene_of(plant: ChainPlant) -> Scene:
        """The plant in 3D: its joints and links, where a subclass draws nothing better."""
        return chain_scene(plant.chain)

    @staticmethod
    def picture_of(
        plant: ChainPlant, scene: Scene, state: Float[np.ndarray, " X"], push: float
    ) -> UInt8[np.ndarray, "H W 3"]:
        """A state from the side: its scene, where a subclass draws nothing better.

        The push is the first input, relative to its limit, in [-1, 1].
        """
        return side_view(scene, state)


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

    def __init__(
        self, single: SwingUpEnv, num_envs: int = 1, max_episode_steps: int | None = None
    ) -> None:
        """A batch of envs with the same physics.

        Raises:
            InputError: a number is no count.
        """
        _require_count("num_envs", num_envs)
        if max_episode_steps is not None:
            _require_count("max_episode_steps", max_episode_steps)
        self._single, self.num_envs = single, num_envs
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
        self._inputs = np.zeros((num_envs, len(self.task.input_names)))
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
        self, actions: Float[np.ndarray, "B U"]
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
        measured = self.swing_up.observe(self._motion, self.np_random)
        terminated = np.zeros(self.num_envs, dtype=bool)
        return measured, rewards, terminated, self._steps >= self._last_step, self._infos()

    def render(self) -> tuple[UInt8[np.ndarray, "H W 3"], ...] | None:
        """A picture of each system, or None without `render_mode="rgb_array"`."""
        if self.render_mode is None:
            return None
        pushes = self._inputs[:, 0] / self.swing_up.input_limit
        return tuple(
            self.picture(state, float(push))
            for state, push in zip(self._motion.states, pushes, strict=True)
        )

    def close_extras(self, **kwargs: Any) -> None:
        """Gives back what pictures are drawn with."""
        self._single.close()

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


def make_batch(
    env: str | type[SwingUpEnv],
    num_envs: int = 1,
    *,
    max_episode_steps: int | None = None,
    **keywords: Any,
) -> SwingUpVectorEnv:
    """The vector env of a class of single envs, or of its `module:Class`, with its keywords."""
    single = load_env_creator(env) if isinstance(env, str) else env
    return SwingUpVectorEnv(single(**keywords), num_envs, max_episode_steps)  # type: ignore[arg-type]


def _require_count(name: str, value: Any) -> None:
    if not (isinstance(value, int | np.integer) and value >= 1):
        raise InputError(f"{name} must be an integer of at least 1, got {value!r}.")
