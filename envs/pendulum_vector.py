"""The pendulum swing-up, many at a time."""

from __future__ import annotations

from typing import Any

from envs.pendulum import PendulumEnv
from envs.swing_up_vector import SwingUpVectorEnv


class PendulumVectorEnv(SwingUpVectorEnv):
    """`num_envs` pendulums in one batch; see `SwingUpVectorEnv` and `PendulumEnv`."""

    def __init__(
        self, num_envs: int = 1, *, max_episode_steps: int | None = 40, **options: Any
    ) -> None:
        """A batch of envs with the same physics.

        Args:
            num_envs: how many pendulums.
            max_episode_steps: steps after which an episode is truncated; None never does.
            **options: the keywords of `PendulumEnv`.

        Raises:
            InputError: a value does not fit.
        """
        super().__init__(PendulumEnv(**options), num_envs, max_episode_steps)
