"""Inputs of a first rollout that are planned, step by step, from what it has shown so far."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.data import Transitions
from mcpilco.dynamics import AngleAugmentation
from mcpilco.kernels import RBF, Kernel, Linear
from mcpilco.policies import Bounds
from mcpilco.task import TaskSpec
from mcpilco.typing import WidenableCost


@dataclass(frozen=True)
class Planning:
    """How inputs are planned; chosen on the cart-pole, by the errors of the models learned."""

    stretches: int = 30
    """an episode is planned in at most so many stretches, in each of which the input is held"""
    random: int = 4
    """first stretches, whose inputs are random: nothing is known yet"""
    ahead: float = 2 / 3
    """part of the episode's stretches that a plan looks ahead [-]"""
    held: int = 3
    """an input of a plan is held for up to so many stretches"""
    plans: int = 256
    """random plans that are compared"""
    varied: float = 0.25
    """part of them that are variations of the last plan [-]"""
    widening: float = 3.0
    """the cost's lengthscales are so many times as large, as at the start of a search [-]"""
    information: float = 0.2
    """what a nat of information is worth, in steps at the goal [-]"""
    noise: float = 0.01
    """variance of what one stretch changes that its start and its input do not say, of 1 [-]"""
    samples: int = 120
    """the model knows the last stretches only, so many at most"""
    fastest: float = 0.04
    """shortest sampling time at which inputs are planned [s]: a plan takes some 10 ms, in which a
    machine would wait"""
    far: float = 30.0
    """a plan that leaves this multiple of the largest state seen is dropped [-]"""


PLANNING = Planning()


class PlannedInputs:
    """Inputs that lead to where a task's cost, made wide, is low and where little is known.

    Random inputs seldom swing a pendulum up, and a model knows nothing of where they did not lead.
    Behind each stretch a Gaussian process with a linear and a Gaussian kernel, whose scales are
    those of the data, predicts the way s_1 ... s_H of random plans, and the first input is taken
    of the plan with the largest

        sum_t w_t + b log det(I + W C W / s^2),    W^2 = diag(w_t),    w_t = 1 - c(s_t)

    C is the covariance of what the Gaussian kernel's function does on that way, given the
    stretches so far, s^2 the noise's variance, and c the widened cost.

    It needs a cost that can be widened, states that are all measured, and time to plan; `applies`
    says whether.

    Reference: the log determinant is the information of a way about the function, Krause, Singh &
    Guestrin, JMLR 9, 2008. Differs: information counts less where the cost does not change, so that
    the system does not run away.
    """

    def __init__(
        self,
        task: TaskSpec,
        low: Bounds,
        high: Bounds,
        horizon: int,
        random: np.random.Generator,
        before: Sequence[Transitions] = (),
        numbers: Planning = PLANNING,
    ) -> None:
        """The inputs of an episode of `horizon` steps, after the rows of episodes before it."""
        assert isinstance(task.cost, WidenableCost), "applies says so"
        self._cost = task.cost.widened(numbers.widening)
        self._low, self._high = np.asarray(low, float), np.asarray(high, float)
        self._augmentation = AngleAugmentation(len(task.state_names), task.angles)
        self._random, self._numbers = random, numbers
        self._stretch = math.ceil(horizon / numbers.stretches)
        self._left = math.ceil(horizon / self._stretch)
        self._ahead = max(1, round(numbers.ahead * self._left))
        self._steps = 0
        self._states: list[np.ndarray] = []
        self._inputs: list[np.ndarray] = []
        self._known = [_in_stretches(rows, self._stretch) for rows in before]
        self._plan = np.zeros((0, len(self._low)))

    @staticmethod
    def applies(task: TaskSpec) -> bool:
        """Whether inputs can be planned for a task."""
        known = isinstance(task.cost, WidenableCost) and task.measured is None
        return known and task.dt >= PLANNING.fastest

    def __call__(self, seen: Float[np.ndarray, " X"]) -> Float[np.ndarray, " U"]:
        """The input behind a measured state; called once a step."""
        if self._steps % self._stretch == 0:
            self._states.append(np.array(seen, dtype=np.float64))
            self._inputs.append(self._next())
            self._left -= 1
        self._steps += 1
        return self._inputs[-1]

    def _next(self) -> np.ndarray:
        rows = self._rows()
        if len(rows) < self._numbers.random:
            return self._random.uniform(self._low, self._high)
        plans = self._drawn(min(self._ahead, max(self._left, 1)))
        model = _Crude(self._augmentation, rows, self._numbers)
        with torch.no_grad():
            best = int(self._worth(model, plans).argmax())
        self._plan = plans[best, 1:].numpy()
        return plans[best, 0].numpy()

    def _rows(self) -> Transitions:
        """The last stretches so far."""
        states = np.array(self._states)
        inputs = np.array(self._inputs).reshape(len(states) - 1, len(self._low))
        rows = Transitions(states[:-1], inputs, states[1:])
        for known in reversed(self._known):
            rows = known + rows
        return rows[np.arange(len(rows))[-self._numbers.samples :]]

    def _drawn(self, stretches: int) -> Float[Tensor, "P H U"]:
        """Random plans, the last one's rest, and variations of that."""
        numbers, random = self._numbers, self._random
        shape = numbers.plans, stretches
        fresh = random.uniform(self._low, self._high, (*shape, len(self._low)))
        # each input is held until the next begins: the places where one does, running on
        begins = np.zeros(shape, dtype=int)
        place = np.zeros(numbers.plans, dtype=int)
        for _ in range(stretches):
            inside = place < stretches
            begins[inside, place[inside]] = place[inside]
            place += random.integers(1, numbers.held + 1, numbers.plans)
        plans = np.take_along_axis(fresh, np.maximum.accumulate(begins, 1)[..., None], 1)
        if rest := min(len(self._plan), stretches):
            varied = round(numbers.varied * numbers.plans)
            plans[:varied, :rest] = self._plan[:rest]
            first = random.integers(0, stretches, varied)
            last = first + random.integers(1, numbers.held + 1, varied)
            for row in range(1, varied):  # the first is the rest as it is
                plans[row, first[row] : last[row]] = fresh[row, 0]
        return torch.from_numpy(plans)

    def _worth(self, model: _Crude, plans: Float[Tensor, "P H U"]) -> Float[Tensor, " P"]:
        states, regressors = model.ways(torch.from_numpy(self._states[-1]), plans)
        closeness = 1.0 - self._cost(states.transpose(0, 1), plans.transpose(0, 1)).T
        root = closeness.clamp(min=0.0).sqrt()
        C = root[:, :, None] * model.covariance(regressors) * root[:, None, :]
        gained = torch.linalg.slogdet(torch.eye(plans.shape[1]).double() + C / self._numbers.noise)
        worth = closeness.sum(1) + self._numbers.information * gained.logabsdet
        sane = worth.isfinite() & model.plausible(states)
        return torch.where(sane, worth, -math.inf)


class _Crude:
    """A model of the next stretch: a GP with a linear and a Gaussian kernel, never fitted."""

    def __init__(
        self, augmentation: AngleAugmentation, rows: Transitions, numbers: Planning
    ) -> None:
        self._augmentation = augmentation
        states, change = map(torch.from_numpy, (rows.states, rows.next_states - rows.states))
        self._far = numbers.far * states.abs().amax(0)
        self._known = X = augmentation.regressors(states, torch.from_numpy(rows.inputs))
        scale = X.std(0)
        circle = slice(len(augmentation.plain), augmentation.width)
        scale[circle] = 0.5**0.5  # of an angle's cosine and sine over a turn
        scale = torch.where(scale > 0, scale, 1.0)
        self._curved: Kernel = RBF(X.shape[-1], lengthscale=scale * X.shape[-1] ** 0.5)
        straight = Linear(X.shape[-1])
        straight.weights = scale.pow(-2)
        self._both = straight + self._curved
        noise = numbers.noise * torch.eye(len(X), dtype=torch.float64)
        self._size = torch.where((size := change.std(0)) > 0, size, 1.0)
        root = torch.linalg.cholesky(self._both(X, X) + noise)
        self._weights = torch.cholesky_solve(change / self._size, root)
        self._root = torch.linalg.cholesky(self._curved(X, X) + noise)

    def ways(
        self, start: Float[Tensor, " X"], plans: Float[Tensor, "P H U"]
    ) -> tuple[Float[Tensor, "P H X"], Float[Tensor, "P H D"]]:
        """The states behind the inputs of each plan, and the regressors at each input."""
        state, states, regressors = start.expand(len(plans), -1), [], []
        for inputs in plans.unbind(1):
            at = self._augmentation.regressors(state, inputs)
            state = state + self._both(at, self._known) @ self._weights * self._size
            regressors.append(at)
            states.append(state)
        return torch.stack(states, 1), torch.stack(regressors, 1)

    def covariance(self, regressors: Float[Tensor, "P H D"]) -> Float[Tensor, "P H H"]:
        """Of the Gaussian kernel's function at these, given the stretches known."""
        cross = self._curved(self._known, regressors)
        seen = torch.linalg.solve_triangular(self._root, cross, upper=False)
        return self._curved(regressors, regressors) - seen.mT @ seen

    def plausible(self, states: Float[Tensor, "P H X"]) -> Tensor:
        """Whether a way stays near what was seen; a linear kernel knows no bounds."""
        return (states.abs() <= self._far).all(-1).all(-1)


def _in_stretches(rows: Transitions, length: int) -> Transitions:
    """The stretches of so many steps that an episode has; a rest of it is left out."""
    whole = len(rows) // length * length
    first, last = slice(0, whole, length), slice(length - 1, whole, length)
    return Transitions(rows.states[first], rows.inputs[first], rows.next_states[last])
