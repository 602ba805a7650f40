"""Returns and success of policies in the simulation of their training, and on the system.

An env that misbehaves raises EnvError, a file that is damaged or cannot be written RunFolderError.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from mcpilco.agent import make_env, task_of
from mcpilco.logbook import read_json, write_json
from mcpilco.sweep import Act, FreshEpisodes, Kept, as_far_as_it_goes
from mcpilco.task import TaskSpec
from mcpilco.typing import RunFolderError

FORMAT = 1

Over = Callable[[int, Mapping[str, float]], None]
"""is called with the number and the outcome of an episode on the system, when it is over"""


@dataclass(frozen=True)
class Place:
    """An env by its id and keywords: a simulation, or the system."""

    env: str
    kwargs: Mapping[str, Any]


@dataclass(frozen=True)
class Outcome:
    """Return, success and one episode of a policy in one place."""

    episodes: int
    """fresh ones, by which it was judged"""
    returns: float
    """mean return [-]"""
    success: float | None
    """share of episodes with success, where the env tells [-]"""
    states: Float[np.ndarray, "T_plus_1 X"]
    """of one episode, in the task's units"""
    inputs: Float[np.ndarray, "T U"]
    """of the same"""

    @property
    def worth(self) -> tuple[float, float]:
        """The key by which policies are ordered: success first, then return."""
        return (-math.inf if self.success is None else self.success), self.returns


@dataclass(frozen=True)
class Crossing:
    """A policy in the simulation that it was trained in, and on the system."""

    trial: int
    """whose policy of the run it is: the best in its own simulation"""
    promised: Outcome
    happened: Outcome
    states: tuple[tuple[str, str], ...]
    """name and unit of each state"""
    inputs: tuple[tuple[str, str], ...]
    """likewise"""
    dt: float
    """sampling time [s]"""


def cross(
    controllers: Mapping[int, Callable[[], Act]],
    simulation: Place | Sequence[Place],
    system: Place,
    horizon: int,
    seed: int,
    episodes: int,
    attempts: int | None = None,
    kept: Kept | None = None,
) -> Crossing:
    """Choose the best policy of a run by its own simulation, and try it on the system.

    The system is met once: no policy is chosen by how it did there. What is promised is of other
    episodes than those that chose it.

    Of the episodes there are `attempts` on the system, None: as many as in the simulation. Those
    that are `kept` already are not repeated; the others join them.

    `controllers` are what makes a policy act, by trial of the training in the simulation; where
    there are several of these, each sees a part of the episodes.
    """
    tried = {
        trial: judged(begin, simulation, horizon, (seed, trial, 0), episodes).worth
        for trial, begin in controllers.items()
    }
    trial = max(tried, key=lambda number: (tried[number], number))
    begin = controllers[trial]
    task = _task(system)
    return Crossing(
        trial,
        promised=judged(begin, simulation, horizon, (seed, trial, 1), episodes),
        happened=judged(begin, system, horizon, (seed, trial, 2), attempts or episodes, kept),
        states=tuple(zip(task.state_names, task.state_units, strict=True)),
        inputs=tuple(zip(task.input_names, task.input_units, strict=True)),
        dt=task.dt,
    )


def judged(
    begin: Callable[[], Act],
    place: Place | Sequence[Place],
    horizon: int,
    seed: Sequence[int],
    episodes: int,
    kept: Kept | None = None,
) -> Outcome:
    """The outcome of a policy in a place, or in some, over fresh episodes.

    In one place those that are `kept` already are not repeated.

    `seed` is run, trial, and which of its judgements this is. The episode that is kept is of the
    first two alone: it begins alike in all places that draw their starts alike.
    """
    first, shown_seed = (
        int(np.random.SeedSequence(tuple(part)).generate_state(1)[0]) for part in (seed, seed[:2])
    )
    places = [place] if isinstance(place, Place) else place
    each, found = math.ceil(episodes / len(places)), []
    for n, one in enumerate(places):
        with FreshEpisodes(one.env, one.kwargs, each, horizon) as fresh:
            found.append(fresh.outcomes(begin, first, n, kept))
    place = places[0]
    with contextlib.closing(make_env(place.env, **place.kwargs)) as env:
        shown = as_far_as_it_goes(env, begin(), horizon, _task(place).dt, seed=shown_seed)
    told = all("is_success" in outcomes for outcomes in found)
    return Outcome(
        episodes=each * len(places),
        returns=float(np.mean([outcomes["return"] for outcomes in found])),
        success=float(np.mean([o["is_success"] for o in found])) if told else None,
        states=shown.shown_states,
        inputs=shown.inputs,
    )


def _task(place: Place) -> TaskSpec:
    with contextlib.closing(make_env(place.env, **place.kwargs)) as env:
        return task_of(env, None, quiet=True)


# Files --------------------------------------------------------------------------------------------


def write_crossing(path: Path, crossing: Crossing) -> None:
    """Write it as JSON, whole or not at all."""
    content = {**vars(crossing), "format": FORMAT}
    for name in ("promised", "happened"):
        outcome = getattr(crossing, name)
        arrays = {"states": outcome.states.tolist(), "inputs": outcome.inputs.tolist()}
        content[name] = {**vars(outcome), **arrays}
    write_json(path, content)


def read_crossing(path: Path) -> Crossing:
    """The crossing in a file of `write_crossing`."""
    content = dict(read_json(path))
    try:
        if content.pop("format") != FORMAT:
            raise ValueError(f'"format" must be {FORMAT}')
        for name in ("promised", "happened"):
            outcome = dict(content[name])
            arrays = {key: np.array(outcome[key], dtype=float) for key in ("states", "inputs")}
            content[name] = Outcome(**{**outcome, **arrays})
        for name in ("states", "inputs"):
            content[name] = tuple((str(word), str(unit)) for word, unit in content[name])
        return Crossing(**content)
    except (KeyError, TypeError, ValueError) as error:
        raise RunFolderError(
            f"{path} is damaged: {error}; delete it, and the same command makes it anew."
        ) from error


class Attempts(list[dict[str, float]]):
    """Outcomes of episodes on the system, in a file that has each as soon as it is over."""

    def __init__(self, path: Path, over: Over) -> None:
        """Those that the file has; `over` is called for each new one."""
        super().__init__(read_json(path)["attempts"] if path.exists() else [])
        self._path, self._over = path, over

    def append(self, outcome: dict[str, float]) -> None:
        super().append(outcome)
        write_json(self._path, {"attempts": self})
        self._over(len(self), outcome)
