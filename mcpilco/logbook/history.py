"""A run read back from its folder: the task, each rollout and its prediction.

What is missing or damaged raises RunFolderError, where a reader does not say otherwise.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from mcpilco.data import Prediction, Rollout, Transitions
from mcpilco.files import read_groups
from mcpilco.logbook.run_folder import RunFolder, read_json
from mcpilco.task import TaskSpec
from mcpilco.typing import McPilcoError, RunFolderError


@dataclass(frozen=True)
class PastTrial:
    """A trial as its run folder holds it; number 0 is the exploration."""

    number: int
    """0, 1, 2, ..."""
    rollout: Rollout
    """on the system"""
    costs: Float[np.ndarray, " T"] | None
    """cost of each step of the rollout [-]; None where an older folder does not tell"""
    prediction: Prediction | None
    """the particles predicted for it; None where no model foresaw it, as in the exploration"""
    row: Mapping[str, Any]
    """its row of metrics.csv, and `predicted_cost_std`; empty for the exploration"""

    @property
    def experience_s(self) -> float:
        """Duration of the data that the policy was learned from [s]."""
        return self.row.get("experience_s", 0.0)

    @property
    def predicted_cost(self) -> float:
        """Cost of an episode as the model predicted it [-]."""
        predicted = self.row.get("predicted_cost")
        return float("nan") if predicted is None else predicted

    @property
    def predicted_cost_std(self) -> float:
        """Its standard deviation over all particles; over those kept where no file tells it [-]."""
        if self.prediction is None:
            return float("nan")
        std = self.row.get("predicted_cost_std")
        return float(self.prediction.costs.sum(0).std(ddof=1) if std is None else std)

    @property
    def real_cost(self) -> float:
        """Cost of the episode on the system [-]."""
        return self.row.get("real_cost", float("nan"))

    @property
    def success(self) -> bool | None:
        """Whether the env called it one; None where it does not tell."""
        return self.row.get("success")


@dataclass(frozen=True)
class History:
    """All that can be read of a run."""

    run: RunFolder
    """where it lies"""
    task: TaskSpec
    """names, units and structure; its cost is not known"""
    trials: tuple[PastTrial, ...]
    """the exploration and the finished trials, in order, but for those that cannot be read"""
    problems: tuple[str, ...]
    """a sentence for each part that cannot be read"""

    @property
    def learned(self) -> tuple[PastTrial, ...]:
        """The trials without the exploration."""
        return tuple(trial for trial in self.trials if trial.number)

    @property
    def foreseen(self) -> bool:
        """Whether a model predicted what a policy would do."""
        return any(trial.prediction is not None for trial in self.trials)

    def transitions_before(self, trial: PastTrial) -> Transitions:
        """The data that the models of a trial were fitted to.

        Raises:
            RunFolderError: a file is missing or damaged, or the folder does not hold all of them.
        """
        rows = [read_transitions(self.run, number) for number in range(trial.number)]
        data = sum(rows[1:], start=rows[0])
        if abs(len(data) * self.task.dt - trial.experience_s) > self.task.dt / 2:
            raise RunFolderError(
                f"Trial {trial.number} was learned from {trial.experience_s:g} s of data, "
                f"{self.run.path} holds {len(data) * self.task.dt:g} s of them."
            )
        return data


def read_history(run: RunFolder) -> History:
    """All that can be read of a run.

    Raises:
        RunFolderError: the folder does not tell what was learned, so that nothing can be read.
    """
    task = read_task(run)
    problems: list[str] = []
    try:
        rows = {row["trial"]: row for row in run.metrics()}
    except RunFolderError as error:
        problems.append(str(error))
        rows = {}
    modelled = any(row["predicted_cost"] is not None for row in rows.values())
    explored = modelled or not rows or run.arrays_path(0, "rollout").parent.exists()
    trials = []
    for number in [*([0] if explored else ()), *rows]:  # who learns no model begins without
        try:
            trials.append(read_trial(run, task, number, rows.get(number, {})))
        except RunFolderError as error:
            problems.append(str(error))
    return History(run, task, tuple(trials), tuple(problems))


def read_task(run: RunFolder) -> TaskSpec:
    """The task as the agent knew it, without its cost.

    A folder that holds no task.json is of an earlier version: its agent tells.
    """
    path = run.path / "task.json"
    if path.exists():
        values = read_json(path)
    else:
        path = run.agent_path
        if not path.exists():
            raise RunFolderError(
                f"{run.path} does not tell what is learned, for neither task.json nor agent.npz "
                "is there; train until the first rollout ends."
            )
        values = read_groups(path)[0].get("task", {})
    try:
        return TaskSpec.from_json(values)
    except Exception as error:  # what a damaged file says may lead to almost anything
        raise RunFolderError(f"{path} is damaged: it holds no task ({error}).") from error


def read_trial(run: RunFolder, task: TaskSpec, number: int, row: Mapping[str, Any]) -> PastTrial:
    """One trial; 0 is the exploration."""
    path = run.arrays_path(number, "rollout")
    arrays = run.read_arrays(number, "rollout")
    try:
        rollout = _rollout(arrays, task)
        costs = _shaped(arrays["costs"], (len(rollout),)) if "costs" in arrays else None
        prediction = None
        path = run.arrays_path(number, "particles")
        if row.get("predicted_cost") is not None or path.exists():
            prediction = _prediction(run.read_arrays(number, "particles"), rollout)
    except (KeyError, ValueError, TypeError) as error:
        raise RunFolderError(f"{path} is damaged, or of another task ({error}).") from error
    with contextlib.suppress(RunFolderError):  # metrics.csv does not hold it
        std = run.result(number).get("predicted_cost_std")
        row = {**row, "predicted_cost_std": std} if isinstance(std, float) else row
    return PastTrial(number, rollout, costs, prediction, row)


def read_transitions(run: RunFolder, number: int) -> Transitions:
    """The rows that a trial, or all of the exploration, added to the data."""
    arrays = run.read_arrays(number, "transitions")
    try:
        return Transitions(**arrays)
    except (McPilcoError, TypeError) as error:
        path = run.arrays_path(number, "transitions")
        raise RunFolderError(f"{path} is damaged ({error}).") from error


def read_search(run: RunFolder) -> dict[int, list[float]]:
    """The cost after each step of each trial's policy search, by trial; all its starts in a row.

    A last line that was cut off, as a crash leaves it, is passed over.
    """
    try:
        text = run.policy_steps_path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise RunFolderError(
            f"{run.policy_steps_path} cannot be read ({error.strerror}); "
            "the course of the policy search is not known."
        ) from error
    costs: dict[int, list[float]] = {}
    for line in text.splitlines():
        try:
            values = json.loads(line)
            if "time/step" in values:
                cost = values["policy/cost"]
                found = costs.setdefault(int(values["time/trial"]), [])
                found.append(float("nan") if cost is None else float(cost))
        except (ValueError, KeyError, TypeError, RecursionError):
            continue
    return costs


def _rollout(arrays: Mapping[str, np.ndarray], task: TaskSpec) -> Rollout:
    steps, width = len(arrays["inputs"]), len(task.state_names)
    made = () if task.measured is None else ("estimates", "smoothed")
    known = {name: arrays[name] for name in (*made, *({"states"} & set(arrays)))}
    prefix = "outcome."
    dt = float(arrays["dt"])
    if not (steps > 0 and 0 < dt < float("inf")):
        raise ValueError(f"it has {steps} steps of {dt} s")
    return Rollout(
        dt=dt,
        observations=_shaped(arrays["observations"], (steps + 1, len(task.measured_states))),
        inputs=_shaped(arrays["inputs"], (steps, len(task.input_names))),
        rewards=_shaped(arrays["rewards"], (steps,)),
        outcome={
            name.removeprefix(prefix): float(value)
            for name, value in arrays.items()
            if name.startswith(prefix)
        },
        **{name: _shaped(array, (steps + 1, width)) for name, array in known.items()},
    )


def _prediction(arrays: Mapping[str, np.ndarray], rollout: Rollout) -> Prediction:
    """The particles; they may be of another length than the rollout, which can end early."""
    steps, particles = arrays["costs"].shape
    if not (steps and particles):
        raise ValueError("it holds no particles")
    width, inputs = rollout.shown_states.shape[1], rollout.inputs.shape[1]
    return Prediction(
        states=_shaped(arrays["states"], (steps + 1, particles, width)),
        inputs=_shaped(arrays["inputs"], (steps, particles, inputs)),
        costs=_shaped(arrays["costs"], (steps, particles)),
    )


def _shaped(array: np.ndarray, shape: tuple[int, ...]) -> Float[np.ndarray, "*shape"]:
    """The array in double precision, or a ValueError where its shape is another."""
    if array.shape != shape:
        raise ValueError(f"expected an array of shape {shape}, got {array.shape}")
    return array.astype(np.float64)
