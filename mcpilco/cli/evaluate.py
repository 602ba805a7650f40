"""`mcpilco evaluate`: how good a run's policy is on fresh rollouts."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from mcpilco.cli.options import RunPath, optional
from mcpilco.cli.system import Command, register, require_at_least, use_one_thread

if TYPE_CHECKING:
    from mcpilco.agent import Agent

_STATISTICS = ("mean", "std", "min", "max")


@dataclass(frozen=True)
class Evaluate(Command):
    """Judge the policy of a run on fresh rollouts."""

    run: RunPath
    """run folder"""
    episodes: int = 100
    """rollouts to judge it by"""
    seed: int = 0
    """of the rollouts; they differ from those of the training for every value"""
    trial: Annotated[int | None, optional("INT", "the last")] = None
    """whose policy"""
    horizon: Annotated[int | None, optional("INT", "that of the training")] = None
    """steps of a rollout"""
    json: bool = False
    """print one JSON object instead of a table"""

    def __call__(self) -> int:
        """Evaluate, print, and return the exit code."""
        require_at_least(1, episodes=self.episodes, horizon=self.horizon)
        require_at_least(0, seed=self.seed)
        use_one_thread()
        register()

        from mcpilco.agent import agent_of, finished_trial, open_run_env
        from mcpilco.logbook import RunFolder

        run = RunFolder.open(self.run)
        trial = finished_trial(run, self.trial)
        env = open_run_env(run, self._keywords(run.config["env_kwargs"]))
        with contextlib.closing(env):
            agent = agent_of(run, trial, env)
            samples = self._measure(agent, run.config["seed"])
        report = {
            "run": str(run.path),
            "trial": trial,
            "episodes": self.episodes,
            **_report(samples),
        }
        if self.json:
            print(json.dumps(report))
        else:
            _print_table(report)
        return 0

    def _keywords(self, trained: Mapping[str, Any]) -> dict[str, Any]:
        """To make the env with: its time limit must not be below the steps asked for."""
        if self.horizon is None:
            return dict(trained)
        limit = max(self.horizon, trained.get("max_episode_steps") or 0)
        return {**trained, "max_episode_steps": limit}

    def _measure(self, agent: Agent, training_seed: int) -> Mapping[str, Any]:
        """The outcome of each rollout, by measure; what the env does not tell is absent."""
        import numpy as np

        from mcpilco.sweep import outcomes_one_by_one

        seeds = np.random.SeedSequence((training_seed, self.seed)).generate_state(self.episodes)
        horizon = self.horizon or agent.horizon
        return outcomes_one_by_one(agent.env, agent.controller, horizon, seeds.tolist())


def _report(samples: Mapping[str, Any]) -> dict[str, Any]:
    """Share of successes, and mean, standard deviation, smallest and largest of each measure."""
    import numpy as np

    report: dict[str, Any] = {}
    if "is_success" in samples:
        report["success_rate"] = float(np.mean(samples["is_success"]))
    for name, values in samples.items():
        if name != "is_success":
            report[name] = {kind: float(getattr(values, kind)()) for kind in _STATISTICS}
    return report


def _print_table(report: Mapping[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from mcpilco.data import title_of

    table = Table(title=f"trial {report['trial']}: {report['episodes']} fresh rollouts")
    table.add_column("measure")
    for statistic in _STATISTICS:
        table.add_column(statistic, justify="right")
    for name, numbers in report.items():
        if isinstance(numbers, dict):
            label = "return [-]" if name == "return" else title_of(name)
            table.add_row(Text(label), *(f"{value:.3f}" for value in numbers.values()))
    console = Console()
    console.print(table)
    if "success_rate" in report:
        successes = round(report["success_rate"] * report["episodes"])
        console.print(
            f"success: {successes} of {report['episodes']} ({report['success_rate']:.0%})",
            highlight=False,
        )
