"""`mcpilco export`: a run's policy as a file that numpy alone can act with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mcpilco.cli.options import RunPath, optional
from mcpilco.cli.system import Command, register
from mcpilco.typing import InputError


@dataclass(frozen=True)
class Export(Command):
    """Write a run's policy as plain arrays, to act with numpy alone."""

    run: RunPath
    """run folder"""
    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    """the .npz file to write; one that is there is replaced"""
    trial: Annotated[int | None, optional("INT", "the last")] = None
    """whose policy"""

    def __call__(self) -> int:
        """Write, and return the exit code."""
        register()
        from mcpilco.agent import ModelBasedAgent, agent_of, finished_trial, write_policy
        from mcpilco.logbook import RunFolder
        from mcpilco.policies import SumOfGaussians

        run = RunFolder.open(self.run)
        trial = finished_trial(run, self.trial)
        agent = agent_of(run, trial)
        if not isinstance(agent.policy, SumOfGaussians):
            raise InputError(
                f"export writes policies of the class SumOfGaussians, got {self.run} with a "
                f"{type(agent.policy).__name__} of the algorithm {agent.algo}."
            )
        assert isinstance(agent, ModelBasedAgent), "only they have such policies"
        path = write_policy(self.file, agent.policy, agent.task, agent.estimator)
        print(f"Policy of trial {trial}: {path}")
        return 0
