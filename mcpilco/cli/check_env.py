"""`mcpilco check-env`: does an env suit the agent, and what to do where it does not."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Annotated

import tyro

from mcpilco.cli.options import TaskPath, given_task, optional
from mcpilco.cli.system import Command, register, require_at_least, use_one_thread

_MARKS = {"fits": "ok", "note": "--", "fault": "no"}


@dataclass(frozen=True)
class CheckEnv(Command):
    """Say what of an env fits the agent and what does not; takes some hundred random steps."""

    env: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ID")]
    """Gymnasium id of the env; `module:Id` imports the module first"""
    task: TaskPath = None
    """what to know of the env, where it does not show it"""
    horizon: Annotated[int | None, optional("INT", "the env's time limit")] = None
    """steps of a rollout"""
    steps: int = 400
    """random steps to judge it by"""
    seed: int = 0
    """of the env and the inputs"""

    def __call__(self) -> int:
        """Print the findings; returns 0 where the agent can use the env, else 1."""
        require_at_least(1, horizon=self.horizon, steps=self.steps)
        require_at_least(0, seed=self.seed)
        use_one_thread()
        register()

        from mcpilco.agent import inspect_env, make_env

        faults = 0
        with contextlib.closing(make_env(self.env)) as env:
            task = given_task(self.task)
            found = inspect_env(env, task, horizon=self.horizon, steps=self.steps, seed=self.seed)
            for finding in found:
                print(f"{_MARKS[finding.kind]}  {finding.sentence}")
                faults += finding.kind == "fault"
        print(f"To mend: {faults}." if faults else "The agent can use this env.")
        return 1 if faults else 0
