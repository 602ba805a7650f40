"""Numbers of the learning, written while it runs: JSON lines and TensorBoard."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal, TextIO

from mcpilco.data import TrialResult
from mcpilco.logbook.callbacks.base import Agent, Callback
from mcpilco.typing import InputError, RunFolderError


def trial_values(result: TrialResult) -> dict[str, float]:
    """The numbers of one trial under their logging keys; without those that are not known."""
    values = {
        "rollout/experience_s": result.experience_s,
        "rollout/predicted_cost": result.predicted_cost,
        "rollout/predicted_cost_std": result.predicted_cost_std,
        "rollout/real_cost": result.real_cost,
        "rollout/ep_return": float(result.rollout.rewards.sum()),
        "rollout/success": result.success,
        **{f"rollout/{name}": value for name, value in result.outcome.items()},
        "policy/steps": result.policy_steps,
        "policy/starts": result.starts,
        "time/wall_s": result.wall_s,
        "time/cpu_s": result.cpu_s,
    }
    return {key: float(value) for key, value in values.items() if value is not None}


class JsonLines(Callback):
    """Numbers of each model fit, policy step and trial: one JSON object a line.

    The keys `time/trial` and `time/step` say where a line belongs; a number that is not finite is
    null. Each line is handed to the system at once, so a crash costs at most one line.
    """

    def __init__(self, path: str | Path, append: bool = False) -> None:
        """Writes into `path`, from the start of the training on; with `append`, after its lines."""
        self.path = Path(path)
        self._mode: Literal["a", "w"] = "a" if append else "w"
        self._file: TextIO | None = None
        self._trial = 0

    def on_training_start(self, agent: Agent, trials: int) -> None:
        """Opens the file.

        Raises:
            RunFolderError: the file cannot be written.
        """
        self.close()
        try:
            self._file = self.path.open(self._mode, encoding="utf-8", buffering=1)
        except OSError as error:
            raise self._unwritable(error) from error

    def on_trial_start(self, trial: int) -> None:
        """Marks the lines to come."""
        self._trial = trial

    def on_model_fitted(self, values: dict[str, float]) -> None:
        """Writes a line."""
        self._write(values)

    def on_policy_step(self, step: int, steps: int, values: dict[str, float]) -> None:
        """Writes a line."""
        self._write({"time/step": step, **values})

    def on_trial_end(self, result: TrialResult) -> None:
        """Writes a line."""
        self._write(trial_values(result))

    def on_training_end(self) -> None:
        """Closes the file."""
        self.close()

    def close(self) -> None:
        """Closes the file."""
        if self._file is not None:
            file, self._file = self._file, None
            with contextlib.suppress(OSError):  # what a full disk did not take was told before
                file.close()

    def _write(self, values: Mapping[str, float]) -> None:
        assert self._file is not None, "on_training_start opens the file"
        finite = {key: value if math.isfinite(value) else None for key, value in values.items()}
        line = json.dumps({"time/trial": self._trial, **finite}, default=float)
        try:
            self._file.write(line + "\n")
        except OSError as error:
            raise self._unwritable(error) from error

    def _unwritable(self, error: OSError) -> RunFolderError:
        return RunFolderError(
            f"cannot write {self.path}: {error.strerror}; make room, or choose another folder."
        )


class TensorBoard(Callback):
    """The same numbers as scalars for TensorBoard; policy steps count on from trial to trial."""

    def __init__(self, folder: str | Path, earlier_steps: int = 0) -> None:
        """Writes event files into `folder` from the start of the training on.

        Args:
            folder: where they go.
            earlier_steps: policy steps of the trials that are there already; what the folder tells
                of later ones no longer counts.

        Raises:
            InputError: the package tensorboard is not installed.
        """
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError as error:
            raise InputError(
                "TensorBoard logging needs the package tensorboard; run `pip install tensorboard`."
            ) from error
        purge = earlier_steps + 1 if earlier_steps else None
        self._open: Callable[[], Any] = lambda: SummaryWriter(str(folder), purge_step=purge)
        self._before = earlier_steps
        self._writer: Any = None

    def on_training_start(self, agent: Agent, trials: int) -> None:
        """Opens an event file."""
        self.close()
        self._writer = self._open()
        self._trial = self._step = 0
        self._earlier_steps = self._before

    def on_trial_start(self, trial: int) -> None:
        """Marks the numbers to come."""
        self._trial = trial
        self._earlier_steps += self._step
        self._step = 0

    def on_model_fitted(self, values: dict[str, float]) -> None:
        """Writes the numbers at the trial."""
        self._write(values, self._trial)

    def on_policy_step(self, step: int, steps: int, values: dict[str, float]) -> None:
        """Writes the numbers at the step, counted over all trials."""
        self._step = step
        self._write(values, self._earlier_steps + step)

    def on_trial_end(self, result: TrialResult) -> None:
        """Writes the numbers at the trial."""
        self._write(trial_values(result), self._trial)
        self._writer.flush()

    def on_training_end(self) -> None:
        """Closes the event file."""
        self.close()

    def close(self) -> None:
        """Closes the event file."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def _write(self, values: Mapping[str, float], step: int) -> None:
        for key, value in values.items():
            self._writer.add_scalar(key, value, step)
