"""Fills a run folder while an agent learns."""

from __future__ import annotations

import contextlib
import functools
import operator
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mcpilco import logbook
from mcpilco.data import Prediction, Rollout, Transitions, TrialResult
from mcpilco.policies import costs_of
from mcpilco.task import TaskSpec


@contextlib.contextmanager
def run_callbacks(
    run: logbook.RunFolder, progress: bool = False, tensorboard: bool = False
) -> Iterator[list[logbook.Callback]]:
    """The callbacks that fill a run folder; files and terminal are given back whatever happens.

    The run was just made, or rewound; one that has event files always goes on with them.
    """
    callbacks: list[Any] = [logbook.JsonLines(run.policy_steps_path, append=True), Recorder(run)]
    events = run.path / "tensorboard"
    if tensorboard or events.exists():
        done = [run.result(trial)["policy_steps"] for trial in run.finished_trials()]
        callbacks.append(logbook.TensorBoard(events, earlier_steps=sum(done)))
    if progress:
        callbacks.append(logbook.Progress())
    with contextlib.ExitStack() as stack:
        for callback in callbacks:
            stack.callback(callback.close)
        yield callbacks


class Recorder(logbook.Callback):
    """Writes each rollout, the policy and GPs behind it and the agent, and at the end a summary.

    The agent comes after all else of a trial, its row in metrics.csv last: a run that is killed
    can go on from what the agent knows.
    """

    def __init__(self, run: logbook.RunFolder) -> None:
        """Writes into `run`, which was just made, or rewound to the last trial of the agent."""
        self.run = run

    def on_training_start(self, agent: logbook.Agent, trials: int) -> None:
        """Starts the clock at what earlier trials have taken; writes what the columns are."""
        self._agent = agent
        self._exploration: list[Rollout] = []
        earlier = self.run.metrics()
        self._wall = time.perf_counter() - sum(row["wall_s"] for row in earlier)
        self._cpu = time.process_time() - sum(row["cpu_s"] for row in earlier)
        logbook.write_json(self.run.path / "task.json", agent.task.to_json())

    def on_exploration(self, rollout: Rollout) -> None:
        self._exploration.append(rollout)
        number = len(self._exploration)
        suffix = "" if number == 1 else f"-{number}"
        rows = functools.reduce(operator.add, map(self._rows, self._exploration))
        self.run.write_arrays(0, "transitions", vars(rows))
        self.run.write_arrays(0, f"rollout{suffix}", _rollout_arrays(rollout, self._agent.task))
        path = self.run.recording_path(0)
        self._record(path.with_stem(path.stem + suffix), f"exploration{suffix}", rollout, None, {})
        known = self._agent.transitions
        if known is None or len(known) == len(rows):  # else another rollout follows
            self._agent.save(self.run.agent_path)

    def on_trial_end(self, result: TrialResult) -> None:
        policy, perception = self._agent.policy.state_dict(), self._agent.perception
        arrays = {
            "transitions": vars(self._rows(result.rollout)),
            "rollout": _rollout_arrays(result.rollout, self._agent.task),
            "particles": {} if result.prediction is None else vars(result.prediction),
            "policy": {name: value.numpy() for name, value in policy.items()},
            "gp": {} if self._agent.model is None else self._agent.model.to_arrays(),
            "perception": {} if perception is None else perception.to_arrays(),
        }
        for name, content in arrays.items():
            if content:
                self.run.write_arrays(result.trial, name, content)
        self.run.write_result(result)
        path = self.run.recording_path(result.trial)
        outcome = _outcome(logbook.values_of(result))
        self._record(path, f"trial {result.trial}", result.rollout, result.prediction, outcome)
        self._agent.save(self.run.agent_path)
        self.run.add_metrics(result)

    def on_training_end(self) -> None:
        self._agent.save(self.run.agent_path)
        trials = self.run.finished_trials()
        last = {"trials": len(trials), **_outcome(self.run.result(trials[-1]))} if trials else {}
        wall, cpu = time.perf_counter() - self._wall, time.process_time() - self._cpu
        self.run.write_summary({**last, "wall_s": wall, "cpu_s": cpu})

    def _rows(self, rollout: Rollout) -> Transitions:
        """The model's training data, past inputs included where its states hold them."""
        model = self._agent.model
        return rollout.transitions().after_inputs(0 if model is None else model.memory)

    def _record(
        self,
        path: Path,
        name: str,
        rollout: Rollout,
        prediction: Prediction | None,
        outcome: Mapping[str, Any],
    ) -> None:
        from mcpilco.show.recording import write_recording  # rerun takes 0.6 s to import

        config = self.run.config
        scene = getattr(self._agent.env.unwrapped, "scene", None)
        properties = {key: config[key] for key in ("env", "preset", "seed")} | dict(outcome)
        write_recording(path, rollout, prediction, self._agent.task, scene, name, properties)


OUTCOME = (
    "success",
    "experience_s",
    "predicted_cost",
    "predicted_cost_std",
    "real_cost",
    "failure",
)
"""the numbers that a trial is judged by, beside the env's measures"""


def _outcome(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: values.get(key) for key in (*OUTCOME, *logbook.measures_in(values))}


def _rollout_arrays(rollout: Rollout, task: TaskSpec) -> dict[str, np.ndarray]:
    arrays = {
        "dt": np.array(rollout.dt),
        "observations": rollout.observations,
        "inputs": rollout.inputs,
        "rewards": rollout.rewards,
        "costs": costs_of(task.cost, rollout),
    }
    for name in ("states", "estimates", "smoothed"):
        if getattr(rollout, name) is not None:
            arrays[name] = getattr(rollout, name)
    return arrays | {f"outcome.{key}": np.array(value) for key, value in rollout.outcome.items()}
