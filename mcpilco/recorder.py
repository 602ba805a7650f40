"""Fills a run folder while an agent learns."""

from __future__ import annotations

import functools
import math
import operator
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mcpilco.callbacks.base import Agent, Callback
from mcpilco.data import Prediction, Rollout, TrialResult
from mcpilco.run_folder import RunFolder


class Recorder(Callback):
    """Writes each rollout, the policy and GPs behind it and the agent, and at the end a summary.

    A trial's row in metrics.csv comes last: it is there when all else of the trial is.
    """

    def __init__(self, run: RunFolder) -> None:
        """Writes into `run`, which `RunFolder.create` has just made."""
        self.run = run

    def on_training_start(self, agent: Agent, trials: int) -> None:
        """Starts the clock."""
        self._agent = agent
        self._exploration: list[Rollout] = []
        self._last: TrialResult | None = None
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def on_exploration(self, rollout: Rollout) -> None:
        """Writes the rollout as trial 0."""
        self._exploration.append(rollout)
        number = len(self._exploration)
        suffix = "" if number == 1 else f"-{number}"
        rows = functools.reduce(operator.add, (past.transitions() for past in self._exploration))
        self.run.write_arrays(0, "transitions", vars(rows))
        self.run.write_arrays(0, f"rollout{suffix}", _rollout_arrays(rollout))
        path = self.run.recording_path(0)
        self._record(path.with_stem(path.stem + suffix), f"exploration{suffix}", rollout, None, {})

    def on_trial_end(self, result: TrialResult) -> None:
        """Writes all that the trial brought."""
        policy = self._agent.policy.state_dict()
        arrays = {
            "transitions": vars(result.rollout.transitions()),
            "rollout": _rollout_arrays(result.rollout),
            "particles": vars(result.prediction),
            "policy": {name: value.numpy() for name, value in policy.items()},
            "gp": self._agent.model.gp.to_arrays(),
        }
        for name, content in arrays.items():
            self.run.write_arrays(result.trial, name, content)
        path = self.run.recording_path(result.trial)
        outcome = _outcome(result)
        self._record(path, f"trial {result.trial}", result.rollout, result.prediction, outcome)
        self._agent.save(self.run.agent_path)
        self.run.add_metrics(result)
        self._last = result

    def on_training_end(self) -> None:
        """Writes the summary."""
        self._agent.save(self.run.agent_path)
        last = {} if self._last is None else {"trials": self._last.trial, **_outcome(self._last)}
        seconds = {
            "wall_s": time.perf_counter() - self._wall,
            "cpu_s": time.process_time() - self._cpu,
        }
        self.run.write_summary({**last, **seconds})

    def _record(
        self,
        path: Path,
        name: str,
        rollout: Rollout,
        prediction: Prediction | None,
        outcome: Mapping[str, Any],
    ) -> None:
        from mcpilco.visual.recording import write_recording  # rerun takes 0.6 s to import

        config = self.run.config
        scene = getattr(self._agent.env.unwrapped, "scene", None)
        properties = {key: config[key] for key in ("env", "preset", "seed")} | dict(outcome)
        write_recording(path, rollout, prediction, self._agent.task, scene, name, properties)


def _outcome(result: TrialResult) -> dict[str, Any]:
    """The numbers that a trial is judged by, as JSON values."""
    values = {
        "experience_s": result.experience_s,
        "predicted_cost": result.predicted_cost,
        "predicted_cost_std": result.predicted_cost_std,
        "real_cost": result.real_cost,
        "time_up_s": result.time_up_s,
        "mean_abs_cart_m": result.mean_abs_cart_m,
    }
    finite = {
        key: None if value is None or not math.isfinite(value) else float(value)
        for key, value in values.items()
    }
    return {"success": None if result.success is None else bool(result.success), **finite}


def _rollout_arrays(rollout: Rollout) -> dict[str, np.ndarray]:
    arrays = {
        "dt": np.array(rollout.dt),
        "observations": rollout.observations,
        "inputs": rollout.inputs,
        "rewards": rollout.rewards,
    }
    for name in ("states", "estimates", "smoothed"):
        if getattr(rollout, name) is not None:
            arrays[name] = getattr(rollout, name)
    return arrays | {f"outcome.{key}": np.array(value) for key, value in rollout.outcome.items()}
