"""Trainings of three steps in copies of this process, for the code that they compile.

The first training after an installation compiles both the simulation of the env and the loops of
the policy search. The search's are made by other processes, while the env compiles its own.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, get_args

import gymnasium as gym
import numpy as np

from mcpilco.agent.agent import MCPILCO
from mcpilco.logbook import Callback
from mcpilco.search import Loop, compile_only, compiled_before

STEPS = 3
"""of an episode"""
PATIENCE_S = 60.0
"""for which a search waits for its loops; then it compiles them itself [s]"""


class Rehearsal(Callback):
    """Waits, before the first search, for what other processes compile."""

    def __init__(self, processes: Sequence[Any]) -> None:
        self._processes = processes

    def on_model_fitted(self, values: dict[str, float]) -> None:
        for process in self._processes:
            process.join(PATIENCE_S)


@contextlib.contextmanager
def rehearsed(agent: Any) -> Iterator[list[Callback]]:
    """Compiles the loops of the agent's search beside what is done meanwhile.

    Yields the callbacks that the training needs: none where there is nothing to compile, no second
    core, or no way to copy a process.
    """
    copies = "fork" in multiprocessing.get_all_start_methods() and sys.platform != "darwin"
    if type(agent) is not MCPILCO or not copies or (os.cpu_count() or 1) < 2 or compiled_before():
        yield []
        return
    fork, loops = multiprocessing.get_context("fork").Process, get_args(Loop)
    processes = [fork(target=_rehearse, args=(agent, loop), daemon=True) for loop in loops]
    for process in processes:
        process.start()
    try:
        yield [Rehearsal(processes)]
    finally:
        for process in processes:
            process.kill()
            process.join()


def _rehearse(agent: MCPILCO, loop: Loop) -> None:
    """Learn one policy, of random observations; whatever comes of it is forgotten."""
    compile_only(loop)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    warnings.simplefilter("ignore")
    config = agent.config
    few: dict[str, Any] = {"steps": (1,), "restarts": (1,), "evaluation_particles": 2}
    config = replace(
        config, horizon=STEPS, exploration=None, search=replace(config.search, **few, particles=2)
    )
    env, kernel = _StandIn(agent.env), agent.kernel
    twin = MCPILCO(agent.policy_name, env, config=config, task=agent.task, kernel=kernel)
    twin.learn(twin.timesteps_of(1))


class _StandIn(gym.Env):
    """Observations without sense, of an env's shape."""

    def __init__(self, env: gym.Env) -> None:
        self.observation_space, self.action_space = env.observation_space, env.action_space
        self._random = np.random.default_rng(0)

    def _observation(self) -> np.ndarray:
        space = self.observation_space
        return self._random.uniform(-0.1, 0.1, space.shape).astype(space.dtype)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, dict]:
        return self._observation(), {}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict]:
        return self._observation(), 0.0, False, False, {}
