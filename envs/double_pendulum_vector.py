"""Pendubots and acrobots, many at a time."""

from __future__ import annotations

from typing import Any

from envs.double_pendulum import AcrobotEnv, PendubotEnv
from envs.swing_up_vector import SwingUpVectorEnv


class PendubotVectorEnv(SwingUpVectorEnv):
    """`num_envs` pendubots in one batch; see `SwingUpVectorEnv` and `PendubotEnv`."""

    def __init__(
        self, num_envs: int = 1, *, max_episode_steps: int | None = 50, **options: Any
    ) -> None:
        """A batch of envs with the same physics.

        Args:
            num_envs: how many pendubots.
            max_episode_steps: steps after which an episode is truncated; None never does.
            **options: the keywords of `PendubotEnv`.

        Raises:
            InputError: a value does not fit.
        """
        super().__init__(PendubotEnv(**options), num_envs, max_episode_steps)


class AcrobotVectorEnv(SwingUpVectorEnv):
    """`num_envs` acrobots in one batch; see `SwingUpVectorEnv` and `AcrobotEnv`."""

    def __init__(
        self, num_envs: int = 1, *, max_episode_steps: int | None = 50, **options: Any
    ) -> None:
        """A batch of envs with the same physics.

        Args:
            num_envs: how many acrobots.
            max_episode_steps: steps after which an episode is truncated; None never does.
            **options: the keywords of `AcrobotEnv`.

        Raises:
            InputError: a value does not fit.
        """
        super().__init__(AcrobotEnv(**options), num_envs, max_episode_steps)
