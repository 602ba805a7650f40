"""A brake: a policy's commands, mapped to those from which a limited state can still stop in time.

What is limited is often pushed by more than the inputs: a pole swings, and its cart goes with it.
But there is a point that the inputs alone push, such as the centre of mass of both. Of a limited
state x with velocity x', angles q and inputs u

    y = x + sum_i (c_i sin q_i + d_i cos q_i),    y'' = sum_j g_j u_j - k x'

is linear in c, d, g and k, which are learned from transitions. While y stays away from a limit by
the lever's length sqrt(c^2 + d^2), x keeps it whatever the angles do. Nothing else is known of the
system. A state that has no such point is not held, and the brake leaves the commands as they are.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.config import Limit
from mcpilco.data import Transitions
from mcpilco.plant import cos, larger, sin, smaller, sqrt
from mcpilco.policies.policies import Bounds
from mcpilco.policies.stage import Stage
from mcpilco.task import TaskSpec

SURE = 3.0
"""standard deviations of what is learned and measured that a brake allows for [-]"""
LEAST = 0.5
"""of the inputs' push, what must be left for the brake to hold a limit [-]"""
LONGEST = 0.75
"""of the way from the start to a limit, what lever and noise may take at most [-]"""
ROUNDED = 0.05
"""of the way in a step at full push: how far before and behind its end the brake is rounded [-]"""
BALANCED = (1, -1, -1, 1)
"""signs of Thue and Morse: what they weigh leaves nothing in a sum, nor in a sum of sums"""
REPEATED = 2
"""steps for which a random input is held behind a brake: what swings is moved more by it [-]"""


class Brake(Stage):
    """From states and commands to inputs from which limited states can still stop."""

    lever: Tensor
    """(L, 2 A), c and d of each angle, in the state's unit"""
    push: Tensor
    """(L, U), g of each input, in the state's unit / s^2 by the input's"""
    reach: Tensor
    """(L,), how far before a limit y must stop, in the state's unit"""
    braking: Tensor
    """(L, 2), deceleration that is left before the lower and the upper limit; 0: it is not held"""

    def __init__(
        self, limits: Sequence[Limit], task: TaskSpec, low: Bounds, high: Bounds, width: int
    ) -> None:
        """A brake that holds nothing yet, for states of so many entries and bounded inputs.

        Limits of states that are no positions are none that it can hold.
        """
        super().__init__()
        velocities, names = dict(task.velocities), task.state_names
        found = [(names.index(limit.state), limit) for limit in limits]
        self._limited = [(x, velocities[x], limit) for x, limit in found if x in velocities]
        self._whole = len(self._limited) == len(limits)
        self._angles = [(q, velocities[q]) for q in task.angles if q in velocities]
        self.bounds = np.array([low, high], dtype=float)
        self.start, self._dt, self.width = task.start_mean, task.dt, width
        L, U = len(self._limited), self.bounds.shape[1]
        shapes = {"lever": (L, 2 * len(self._angles)), "push": (L, U), "reach": (L,)}
        for name, shape in (shapes | {"braking": (L, 2)}).items():
            self.register_buffer(name, torch.zeros(shape, dtype=torch.float64))

    @property
    def held(self) -> list[int]:
        """Which of its limits it holds."""
        return [i for i, left in enumerate(self.braking.tolist()) if min(left) > 0]

    @property
    def holds(self) -> bool:
        """Whether it holds all that were set."""
        return self._whole and len(self.held) == len(self._limited)

    @property
    def acts(self) -> bool:
        return bool(self.held)

    # --- learning ---------------------------------------------------------------------------------

    def learn(self, rows: Transitions) -> None:
        """Fit the points that the inputs move to transitions, in place."""
        for i, (x, v, limit) in enumerate(self._limited):
            ends = (limit.low, limit.high)
            room = min(abs(end - self.start[x]) for end in ends if end is not None)
            self.braking[i] = 0.0
            if len(rows) > self.lever.shape[1] + self.push.shape[1] + 2:
                self._fit(i, x, v, room, rows)

    def _fit(self, i: int, x: int, v: int, room: float, rows: Transitions) -> None:
        """Least squares on the change of y' in each step, and what y must keep away for errors."""
        before, after = rows.states, rows.next_states
        now, then = self._swings(x, before), self._swings(x, after)
        change, way = after[:, v] - before[:, v], after[:, x] - before[:, x]
        features = np.column_stack([now - then, self._dt * rows.inputs, -way])
        levers = now.shape[1]
        found, std, error = _least_squares(features, change, levers, room)
        (c, g, _), (std_c, std_g, _) = (np.split(a, [levers, -1]) for a in (found, std))
        speeds = before[:, v] + after[:, v] + (now + then) @ c
        missed = (
            way + (self._levers(x, after) - self._levers(x, before)) @ c - self._dt / 2 * speeds
        )
        noise = math.sqrt(np.square(missed).mean() / 2)  # of y, measured twice in a step
        reach = np.hypot(*c.reshape(2, -1)).sum() + SURE * (noise + math.hypot(*std_c))
        unsure = SURE * (np.abs(self.bounds).max(0) @ std_g + error / self._dt)
        most = np.array([1.0, -1.0]) * np.sort(self.bounds * g, 0).sum(1)[::-1]
        if (most - unsure).min() > LEAST * most.max() and reach < LONGEST * room:
            for name, values in {"lever": c, "push": g, "braking": most - unsure}.items():
                getattr(self, name)[i] = torch.from_numpy(values)
            self.reach[i] = reach

    def _levers(self, x: int, states: Float[np.ndarray, "N X"]) -> Float[np.ndarray, "N A2"]:
        """sin q and cos q of each angle, but for the limited one."""
        q = states[:, [i for i, _ in self._angles]]
        free = np.array([i != x for i, _ in self._angles], dtype=float)
        return np.hstack([free * np.sin(q), free * np.cos(q)])

    def _swings(self, x: int, states: Float[np.ndarray, "N X"]) -> Float[np.ndarray, "N A2"]:
        """Their derivatives by time."""
        w = states[:, [i for _, i in self._angles]]
        sines, cosines = np.hsplit(self._levers(x, states), 2)
        return np.hstack([w * cosines, -w * sines])

    # --- braking ----------------------------------------------------------------------------------

    def rows(self, given: Sequence[Any]) -> list[Any]:
        """The inputs, each between its command and one of its bounds; the last limit prevails."""
        inputs = list(given[len(given) - self.bounds.shape[1] :])
        for i in self.held:
            inputs = self._braked(i, given, inputs)
        return inputs

    def _braked(self, i: int, given: Sequence[Any], inputs: list[Any]) -> list[Any]:
        """Inputs between their commands and those that push y back the most.

        Weights are such that the interval of all commands becomes that of the admissible pushes.
        """
        (x, v, limit), lever, push = self._limited[i], self.lever[i].tolist(), self.push[i].tolist()
        y, dy, A = given[x], given[v], len(self._angles)
        for (q, w), c, d in zip(self._angles, lever[:A], lever[A:], strict=True):
            y = y + c * sin(given[q]) + d * cos(given[q])
            dy = dy + (c * cos(given[q]) - d * sin(given[q])) * given[w]
        low, high = self.bounds
        ends = np.where(np.array(push) > 0, (low, high), (high, low)).T.tolist()
        least, most = (np.array(ends).T @ push).tolist()
        reach, (lower, upper) = float(self.reach[i]), self.braking[i].tolist()
        back, forth = 0.0, 0.0
        if limit.high is not None:
            allowed = self._highest(limit.high - reach - y, dy, upper)
            back = smaller(larger((most - allowed) / (most - least), 0.0), 1.0)
        if limit.low is not None:
            allowed = self._highest(y - (limit.low + reach), -dy, lower)
            forth = smaller(larger((-allowed - least) / (most - least), 0.0), 1.0)
        total = larger(back + forth, 1.0)
        back, forth = back / total, forth / total
        pairs = zip(inputs, ends, strict=True)
        return [u + back * (end[0] - u) + forth * (end[1] - u) for u, end in pairs]

    def _highest(self, left: Any, speed: Any, braking: float) -> Any:
        """The largest acceleration for a step after which y can stop within the way that is left.

        At the speed s at the step's end, s^2 / 2 b + b dt^2 / 8 is enough for steps of constant
        deceleration of at most b, so that s = sqrt(2 b (left - dt y' / 2)) - b dt / 2.
        """
        rounded = ROUNDED * braking * self._dt**2
        gap = left - speed * (self._dt / 2)
        gap = (gap + sqrt(gap * gap + rounded * rounded)) * 0.5
        return (sqrt(gap * (2 * braking)) - braking * self._dt / 2 - speed) * (1.0 / self._dt)


def _least_squares(
    features: Float[np.ndarray, "N D"], target: Float[np.ndarray, " N"], levers: int, room: float
) -> tuple[Float[np.ndarray, " D"], Float[np.ndarray, " D"], float]:
    """Weights, their standard deviations and the residual's; the first weights are of the room."""
    plain = np.linalg.lstsq(features, target, rcond=None)[0]
    freedom = len(features) - features.shape[1]
    variance = float(np.square(target - features @ plain).sum()) / freedom
    prior = np.zeros(features.shape[1])
    prior[:levers] = variance / room**2
    inverse = np.linalg.pinv(features.T @ features + np.diag(prior))
    std = np.sqrt(variance * np.diag(inverse).clip(0.0))
    return inverse @ features.T @ target, std, math.sqrt(variance)


def careful(
    brake: Brake,
    draws: Iterator[Float[np.ndarray, " U"]],
    known: Sequence[Transitions],
    learns: bool = True,
) -> Callable[[Float[Tensor, " X"]], Float[Tensor, " U"]]:
    """Random inputs for an episode, braked as what is known tells; it may learn from each step.

    While it does not hold all limits, each draw comes four times, with signs that leave no speed
    and no way of what integrates it once or twice; from then on it is held for some steps.
    """
    middle = brake.bounds.mean(0)
    around = (middle + sign * (u - middle) for u in draws for sign in BALANCED)
    repeated = itertools.chain.from_iterable(itertools.repeat(u, REPEATED) for u in draws)
    states: list[np.ndarray] = []
    inputs: list[np.ndarray] = []
    if known:
        brake.learn(functools.reduce(Transitions.__add__, known))

    def act(state: Float[Tensor, " X"]) -> Float[Tensor, " U"]:
        states.append(state.numpy()[: len(brake.start)])
        if inputs and learns:
            now = Transitions(*map(np.array, (states[:-1], inputs, states[1:])))
            brake.learn(functools.reduce(Transitions.__add__, known, now))
        u = brake(state, torch.from_numpy(next(repeated if brake.holds else around)))
        inputs.append(u.numpy())
        return u

    return act
