"""The events of a training, and the base class of callbacks."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Protocol

from mcpilco.data import Rollout, Transitions, TrialResult
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError


class Agent(Protocol):
    """The attributes of an agent that callbacks may read."""

    env: Any
    task: TaskSpec
    policy: Any
    model: Any
    perception: Any
    transitions: Transitions | None
    results: list[TrialResult]
    config: Any

    def save(self, path: str | Path) -> Path:
        """Write the agent to a file, whole or not at all."""
        ...


class Callback:
    """Does nothing; subclass and override what you need.

    An exception raised in a callback ends the training.
    """

    def on_training_start(self, agent: Agent, trials: int) -> None:
        """Called once, before the first step on the system; `trials` policies will be learned."""

    def on_exploration(self, rollout: Rollout) -> None:
        """Called after each rollout of random inputs."""

    def on_trial_start(self, trial: int) -> None:
        """Called before the models of trial 1, 2, ... are fitted."""

    def on_model_fitted(self, values: dict[str, float]) -> None:
        """Called with the numbers of the fitted models, such as `model/nlml`."""

    def on_policy_step(self, step: int, steps: int, values: dict[str, float]) -> None:
        """Called after optimisation step 1, 2, ... of the trial, of at most `steps` as seen now."""

    def on_trial_end(self, result: TrialResult) -> None:
        """Called when the new policy has been tried on the system."""

    def on_training_end(self) -> None:
        """Called once, after the last trial; not called when training fails."""

    def close(self) -> None:
        """Gives back files and the terminal; its maker calls it, also after an error."""


def _told_to_all(event: str) -> Callable[..., None]:
    """The method of a list that passes an event on to each of its callbacks."""

    def tell(self: CallbackList, *about: Any) -> None:
        for callback in self.callbacks:
            getattr(callback, event)(*about)

    return tell


class CallbackList(Callback):
    """Several callbacks, called in order."""

    def __init__(self, callbacks: Iterable[Callback]) -> None:
        self.callbacks = list(callbacks)

    on_training_start = _told_to_all("on_training_start")
    on_exploration = _told_to_all("on_exploration")
    on_trial_start = _told_to_all("on_trial_start")
    on_model_fitted = _told_to_all("on_model_fitted")
    on_policy_step = _told_to_all("on_policy_step")
    on_trial_end = _told_to_all("on_trial_end")
    on_training_end = _told_to_all("on_training_end")
    close = _told_to_all("close")


def as_callback(callback: Callback | Iterable[Callback] | None, *more: Callback) -> Callback:
    """One callback that stands for what the user gave (nothing, one, or several) and for `more`.

    Raises:
        InputError: an object that is no Callback.
    """
    if callback is None:
        given = []
    elif isinstance(callback, Iterable):
        given = list(callback)
    else:
        given = [callback]
    strangers = [type(member).__name__ for member in given if not isinstance(member, Callback)]
    if strangers:
        raise InputError(
            f"callback must be a mcpilco Callback or a list of them, got {', '.join(strangers)}; "
            "subclass mcpilco.logbook.callbacks.Callback."
        )
    return CallbackList([*given, *more])
