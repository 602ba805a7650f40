"""`mcpilco evaluate`, `export` and `report`: what is made of a finished run."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from mcpilco.cli import options
from mcpilco.typing import EnvError, InputError

if TYPE_CHECKING:
    from mcpilco.agent import TrialAgent

_STATISTICS = ("mean", "std", "min", "max")


@dataclass(frozen=True)
class Evaluate(options.OnMachine):
    """Judge the policy of a run on fresh rollouts."""

    run: options.RunPath
    """run folder"""
    episodes: int = 100
    """rollouts to judge it by"""
    seed: int = 0
    """of the rollouts; they differ from those of the training for every value"""
    trial: Annotated[int | None, options.optional("INT", "the last")] = None
    """whose policy"""
    horizon: Annotated[int | None, options.optional("INT", "that of the training")] = None
    """steps of a rollout"""
    json: bool = False
    """print one JSON object instead of a table"""
    trust: options.Trust = ()
    """modules of your own that the run names; they are imported"""

    def __call__(self) -> int:
        options.require_at_least(1, episodes=self.episodes, horizon=self.horizon)
        options.require_at_least(0, seed=self.seed)
        options.use_one_thread()
        options.register(trusted=self.trust)

        from mcpilco.agent import agent_of, finished_trial, make_env
        from mcpilco.logbook import RunFolder

        run = RunFolder.open(self.run)
        trial = finished_trial(run, self.trial)
        place = self.place(run.config["env"], self._keywords(run.config["env_kwargs"]))
        with (
            self.met(run.path / "machine"),
            contextlib.closing(make_env(place[0], **place[1])) as env,
        ):
            agent = agent_of(run, trial, env)
            samples = self._measure(agent, run.config["seed"])
        done = len(samples["return"])
        report = {"run": str(run.path), "trial": trial, "episodes": done, **_report(samples)}
        if self.json:
            print(json.dumps(report))
        else:
            _print_table(report)
        return int(done < self.episodes)

    def _keywords(self, trained: Mapping[str, Any]) -> dict[str, Any]:
        """To make the env with: its time limit must not be below the steps asked for."""
        if self.horizon is None:
            return dict(trained)
        limit = max(self.horizon, trained.get("max_episode_steps") or 0)
        return {**trained, "max_episode_steps": limit}

    def _measure(self, agent: TrialAgent, training_seed: int) -> Mapping[str, Any]:
        """The outcome of each rollout, by measure; what the env does not tell is absent.

        There are fewer of them than asked for where the system does not begin another one.
        """
        import numpy as np

        from mcpilco.agent import horizon_of
        from mcpilco.sweep import gathered, outcomes_one_by_one

        done: list[dict[str, float]] = []
        seeds = np.random.SeedSequence((training_seed, self.seed)).generate_state(self.episodes)
        horizon = horizon_of(agent.env, self.horizon or agent.horizon)
        try:
            return outcomes_one_by_one(agent.env, agent.controller, horizon, seeds.tolist(), done)
        except EnvError as error:
            if not done:
                raise
            options.warn(f"after {len(done)} of {self.episodes} rollouts: {error}")
            return gathered(done)


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


@dataclass(frozen=True)
class Export(options.Command):
    """Write a run's policy: as arrays for numpy, as C, or as an ONNX graph.

    Beside the C header and the graph stand a contract (FILE.json: names, units, order, rate,
    limits, memory) and golden vectors (FILE.golden.csv). Files that are there are replaced.
    """

    run: options.RunPath
    """run folder"""
    file: Annotated[tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="FILE")] = None
    """the .npz file to write: arrays, to act with numpy alone"""
    c: Annotated[Path | None, options.optional("FILE.h", "none")] = None
    """one C99 header that needs no other file and allocates nothing; needs jinja2"""
    onnx: Annotated[Path | None, options.optional("FILE.onnx", "none")] = None
    """an ONNX graph, whose memory goes in and out; needs onnx"""
    vectors: int = 10_000
    """golden vectors beside the header and the graph"""
    trial: Annotated[int | None, options.optional("INT", "the last")] = None
    """whose policy"""
    trust: options.Trust = ()
    """modules of your own that the run names; they are imported"""

    def __call__(self) -> int:
        options.require_at_least(0, vectors=self.vectors)
        if self.file is None and self.c is None and self.onnx is None:
            raise InputError("export needs to know where to write: policy.npz, --c or --onnx.")
        options.register(trusted=self.trust)
        from mcpilco.agent import (
            ModelBasedAgent,
            agent_of,
            finished_trial,
            write_c,
            write_onnx,
            write_policy,
        )
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
        parts = agent.policy, agent.task, agent.estimator
        if self.file is not None:
            print(f"Policy of trial {trial}: {write_policy(self.file, *parts)}")
        for path, write in ((self.c, write_c), (self.onnx, write_onnx)):
            if path is not None:
                code, contract, golden = write(path, *parts, self.vectors)
                print(f"Policy of trial {trial}: {code}; its contract: {contract}; ", end="")
                print(f"{self.vectors} golden vectors: {golden}")
        return 0


@dataclass(frozen=True)
class Report(options.Command):
    """Write a run as one HTML page that needs no other file."""

    run: options.RunPath
    """run folder"""
    out: Annotated[Path | None, options.optional("FILE", "report.html in the run folder")] = None
    """the page"""
    trust: options.Trust = ()
    """modules of your own that the run names; they are imported"""

    def __call__(self) -> int:
        options.use_one_thread()
        options.register(trusted=self.trust)
        from mcpilco.logbook import RunFolder
        from mcpilco.show.report import write_report

        print(write_report(RunFolder.open(self.run), self.out))
        return 0
