"""Measured data: rows for the models, one rollout of the system, the result of one trial."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np
from jaxtyping import Float

from mcpilco.typing import InputError

UNITS: Mapping[str, str] = {
    "s": "s",
    "m": "m",
    "rad": "rad",
    "deg": "deg",
    "m_per_s": "m/s",
    "rad_per_s": "rad/s",
    "N": "N",
    "Nm": "N m",
    "J": "J",
    "W": "W",
    "kg": "kg",
    "V": "V",
    "A": "A",
    "K": "K",
    "percent": "%",
}
"""units that the name of a measure may end with, as they are printed"""
SPENT = ("experience_s", "wall_s", "cpu_s")
"""what a trial takes; these names are no env's"""


def is_measure(name: str) -> bool:
    """True for the name of a measure that an env may report: it ends with its unit.

    An env reports measures of an episode as numbers in `info`, such as `info["time_up_s"]` [s];
    whether the episode was a success is `info["is_success"]`.
    """
    return name[:1] != "_" and name not in SPENT and _unit_suffix(name) is not None


def title_of(measure: str) -> str:
    """The name of a measure with its unit in brackets: `time_up_s` is "time up [s]"."""
    suffix = _unit_suffix(measure)
    if suffix is None:
        return measure.replace("_", " ")
    return f"{measure.removesuffix('_' + suffix).replace('_', ' ')} [{UNITS[suffix]}]"


def html_table(rows: Sequence[Mapping[str, str]]) -> str:
    """A table in HTML, as notebooks show it, under the columns that any row has."""
    titles = dict.fromkeys(title for row in rows for title in row)

    def line(kind: str, cells: Iterable[str]) -> str:
        return f"<tr>{''.join(f'<{kind}>{escape(cell)}</{kind}>' for cell in cells)}</tr>"

    body = "".join(line("td", (row.get(title, "-") for title in titles)) for row in rows)
    return f"<table><thead>{line('th', titles)}</thead><tbody>{body}</tbody></table>"


def _unit_suffix(name: str) -> str | None:
    """The longest unit that a name ends with."""
    found = [unit for unit in UNITS if name.endswith(f"_{unit}") and len(name) > len(unit) + 1]
    return max(found, key=len, default=None)


def _check_finite(name: str, array: np.ndarray) -> None:
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        row = bad[0].tolist()
        raise InputError(
            f"{name} must be finite, got {array[tuple(bad[0])]} at index {row}; "
            "remove the row or mend the sensor."
        )


@dataclass(frozen=True)
class Transitions:
    """N measured steps (x, u, x'), the rows that the models learn from."""

    states: Float[np.ndarray, "N X"]
    """observed state before the step"""
    inputs: Float[np.ndarray, "N U"]
    """input held during the step"""
    next_states: Float[np.ndarray, "N X"]
    """observed state after the step"""

    def __post_init__(self) -> None:
        shapes = self.states.shape, self.inputs.shape, self.next_states.shape
        matrices = all(len(shape) == 2 for shape in shapes)
        if not matrices or len(self.inputs) != len(self.states) or shapes[0] != shapes[2]:
            raise InputError(
                "Transitions need matrices, as many rows of inputs and next states as of states, "
                f"got shapes {shapes[0]}, {shapes[1]}, {shapes[2]}."
            )
        for name in ("states", "inputs", "next_states"):
            _check_finite(f"Transitions.{name}", getattr(self, name))

    def __len__(self) -> int:
        return len(self.states)

    def __add__(self, other: Transitions) -> Transitions:
        """These rows and then the other's."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Transitions(*map(np.concatenate, pairs))

    def after_inputs(self, memory: int) -> Transitions:
        """The rows of one episode, each state with the commands before it behind, newest first.

        Before its start an episode's commands were 0.
        """
        if memory == 0:
            return self
        N, U = self.inputs.shape
        commands = np.concatenate([np.zeros((memory, U)), self.inputs])
        past = [commands[memory - k : memory - k + N] for k in range(memory + 1)]
        before, after = np.concatenate(past[1:], 1), np.concatenate(past[:-1], 1)
        return Transitions(
            np.concatenate([self.states, before], 1),
            self.inputs,
            np.concatenate([self.next_states, after], 1),
        )

    def mirrored(self) -> Transitions:
        """The same with all signs turned: what a system does that looks the same in a mirror."""
        return Transitions(-self.states, -self.inputs, -self.next_states)

    def __getitem__(self, rows: slice | np.ndarray) -> Transitions:
        """Some of the rows."""
        return Transitions(self.states[rows], self.inputs[rows], self.next_states[rows])


@dataclass(frozen=True)
class Rollout:
    """One episode on the system, T steps long."""

    dt: float
    """sampling time [s]"""
    observations: Float[np.ndarray, "T_plus_1 Y"]
    """what was measured, noise included: all states, or `TaskSpec.measured` of them"""
    inputs: Float[np.ndarray, "T U"]
    """inputs applied"""
    rewards: Float[np.ndarray, " T"]
    """rewards received [-]"""
    states: Float[np.ndarray, "T_plus_1 X"] | None = None
    """true states, where the env tells them in `info["state"]`"""
    outcome: Mapping[str, float] = field(default_factory=dict)
    """what the env reports of the episode in `info` at its last step: `is_success`, and numbers
    whose names end with their unit, see `is_measure`"""
    estimates: Float[np.ndarray, "T_plus_1 X"] | None = None
    """where states are measured in part: what was known of them at each step, by then"""
    smoothed: Float[np.ndarray, "T_plus_1 X"] | None = None
    """where states are measured in part: what is known of them after the episode"""

    def __len__(self) -> int:
        return len(self.inputs)

    @property
    def times(self) -> Float[np.ndarray, " T_plus_1"]:
        """Time of each observation [s]."""
        return self.dt * np.arange(len(self.observations))

    @property
    def shown_states(self) -> Float[np.ndarray, "T_plus_1 X"]:
        """The true states where they are known, else the best that is known of them."""
        return self._known if self.states is None else self.states

    @property
    def _known(self) -> Float[np.ndarray, "T_plus_1 X"]:
        return self.observations if self.smoothed is None else self.smoothed

    def transitions(self) -> Transitions:
        """The rows (state, input, next state): states as observed, or else as smoothed."""
        return Transitions(self._known[:-1], self.inputs, self._known[1:])


@dataclass(frozen=True)
class Prediction:
    """The rollout that the model predicts for a policy: P particles over T steps, as arrays."""

    states: Float[np.ndarray, "T_plus_1 P X"]
    inputs: Float[np.ndarray, "T P U"]
    costs: Float[np.ndarray, "T P"]
    """cost of each particle at the end of each step [-]"""

    def of_states(self, width: int) -> Prediction:
        """The same without what stands behind the first entries of a state."""
        return Prediction(self.states[..., :width], self.inputs, self.costs)

    def later(self, samples: int) -> Prediction:
        """The same of an actuator that answers so much later; till then states are the first."""
        T = len(self.costs)
        at = np.maximum(np.arange(T + 1) - samples, 0)
        return Prediction(self.states[at], self.inputs, self.costs[at[:T]])


@dataclass(frozen=True)
class TrialResult:
    """One trial: a model learned, a policy searched in it, and a fresh rollout of that policy."""

    trial: int
    """1, 2, ..."""
    experience_s: float
    """duration of the data that the policy was trained on [s]"""
    predicted_cost: float
    """what the model expected: sum over the steps of the mean over particles [-]"""
    predicted_cost_std: float
    """standard deviation of that sum over particles [-]"""
    real_cost: float
    """what came: sum of the task's cost over the steps of the rollout on the system [-]"""
    success: bool | None
    """`info["is_success"]` at the end of the rollout; None where the env does not report it"""
    noise_std: tuple[float, ...]
    """noise standard deviation that each GP learned, in the unit of its target"""
    policy_steps: int
    """optimisation steps spent, all starts together"""
    starts: int
    """how many starting points the policy search tried"""
    wall_s: float
    """wall-clock time of the trial [s]"""
    cpu_s: float
    """processor time of the trial [s]"""
    rollout: Rollout
    """the rollout on the system"""
    prediction: Prediction | None
    """the particles predicted for that policy before it was tried; None where no new policy could
    be learned, and the last one was tried again"""
    failure: str | None = None
    """why no new policy could be learned, or why the rollout broke off; None where all went well"""
    limits_kept: float | None = None
    """share of the particles that keep all limits of the states [-]; None where there are none, or
    where a brake holds them"""
    limits_crossed: bool | None = None
    """whether the rollout did cross one; None where there are none"""

    @property
    def outcome(self) -> Mapping[str, float]:
        """The measures that the env reports of the rollout, by names that end with their unit."""
        return {name: value for name, value in self.rollout.outcome.items() if is_measure(name)}


@dataclass(frozen=True)
class Spent:
    """A time that was spent on some work."""

    wall_s: float = 0.0
    """as a clock shows it [s]"""
    cpu_s: float = 0.0
    """of this process, all its threads together [s]"""

    def __add__(self, other: Spent) -> Spent:
        return Spent(self.wall_s + other.wall_s, self.cpu_s + other.cpu_s)

    def __sub__(self, other: Spent) -> Spent:
        return Spent(self.wall_s - other.wall_s, self.cpu_s - other.cpu_s)


class Stopwatch:
    """Measures the time since it was made."""

    def __init__(self) -> None:
        self._since = _now()

    def read(self) -> Spent:
        """The time until now."""
        return _now() - self._since


def _now() -> Spent:
    return Spent(time.perf_counter(), time.process_time())
