"""A linear regulator: near the goal, where the model is sure enough, it takes over from the policy.

The model of the next state is linearised about the goal x* and the inputs u* that hold it there,

    x' - x* = A e + B (u - u*),    e = x - x*,

and the discrete Riccati equation gives the law u = u* - K e of least cost, the sum of e'Qe + u'Ru,
and e'Se, the cost to come. Q is one per squared error that counts as much as a largest input, of
each state: one of its unit, unless another is told. So that full turns look alike, e of an angle is
sin(e) (4 - cos(e)) / 3, which is e to the fifth order.

The region is e'Se < c; c is the largest for which the law asks for at most `room` times the input
that there is, where it is cut off. To half of the way to its edge the regulator acts alone, from
there on its share falls to 0; so it does between 60 and 90 degrees from an angle's goal.

A model that has seen nothing near the goal has no regulator: of systems drawn from what it leaves
possible, the law must bring a share, `trust`, to rest within the inner half of the region.

Reference: Anderson & Moore, Optimal Control: Linear Quadratic Methods, 1990, chapters 2 and 3;
Bryson & Ho, Applied Optimal Control, 1975, section 5.2 (weights); Spong, IEEE Control Systems 15
(1), 1995 (a swing-up that a linear regulator ends).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from scipy.linalg import solve_discrete_are
from torch import Tensor

from mcpilco.config import PolicyConfig
from mcpilco.dynamics import GPDynamics, Linearised, PathwisePosterior, PhysicsDynamics, linearised
from mcpilco.plant import cos, larger, sin, smaller
from mcpilco.policies.policies import Bounds
from mcpilco.policies.stage import Stage
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError

logger = logging.getLogger(__name__)

DRAWS = 100
"""systems drawn from the model"""
INNER = 0.25
"""of c, to which the regulator acts alone: half of the way to the edge [-]"""
PAST = 1e-3
"""cost of a past input in a state, to that of an input [-]: it is paid for, but S must be
definite"""
SETTLED = 1e-9
"""change of u*, to the input's half range, at which it is found [-]; it is nearly linear"""
MOST = 20
"""steps of Gauss and Newton to find it"""
UNMOVED = 1e-7
"""to the size of [A - z, B]: what of an unstable mode the inputs must reach [-]"""

Matrix = Float[np.ndarray, "X X"]


class Regulator(Stage):
    """u = u* - K e in a region about the goal, the commands outside of it."""

    gain: Tensor
    """(U, X), K, in the input's unit by the state's"""
    value: Tensor
    """(X, X), S [-], by both states' units"""
    goal: Tensor
    """(X,), x*, in each state's unit"""
    inputs: Tensor
    """(U,), u*, in each input's unit"""
    level: Tensor
    """c [-]; 0: it does not act"""

    def __init__(
        self, config: PolicyConfig, task: TaskSpec, low: Bounds, high: Bounds, memory: int = 0
    ) -> None:
        """A regulator that does not act yet; `learn` or `hold` gives it a law.

        Args:
            config: the room that it has, the units of states, and the share of systems to hold.
            task: with a goal.
            low: least inputs, in their units.
            high: largest ones.
            memory: how many past inputs stand behind a state.

        Raises:
            InputError: the task has no goal, or not as many states as there are units.
        """
        super().__init__()
        if task.goal is None:
            raise InputError(
                "A regulator needs the state to hold, got a task without a goal: set "
                "TaskSpec.goal, with one number for each state, in the env or by --task."
            )
        units = config.regulator_units or (1.0,) * len(task.goal)
        if len(units) != len(task.goal):
            raise InputError(
                "regulator_units must have one number for each of the states "
                f"{', '.join(task.state_names)}, got {units}."
            )
        self.room, self.trust = config.regulator, config.regulator_trust
        self.bounds = np.array([low, high], dtype=float)
        self.names, self.angles = task.after_inputs(memory).state_names, task.angles
        self.width, U = len(self.names), self.bounds.shape[1]
        # x* = goal + held u*: past inputs are those that hold it
        self._held = np.concatenate(
            [np.zeros((len(task.goal), U)), np.tile(np.eye(U), (memory, 1))]
        )
        self._goal = np.array([*task.goal, *[0.0] * (U * memory)])
        self._costs = np.array([*units, *[1.0] * (U * memory)]) ** -2.0
        shapes = {"gain": (U, self.width), "value": (self.width,) * 2, "inputs": (U,)}
        for name, shape in (shapes | {"goal": (self.width,), "level": ()}).items():
            self.register_buffer(name, torch.zeros(shape, dtype=torch.float64))

    @property
    def acts(self) -> bool:
        return bool(self.level > 0)

    def rows(self, given: Sequence[Any]) -> list[Any]:
        states, commands = given[: self.width], given[self.width :]
        e = [x - goal for x, goal in zip(states, self.goal.tolist(), strict=True)]
        near = [2.0 * cos(e[i]) for i in self.angles]
        for i in self.angles:
            e[i] = sin(e[i]) * ((4.0 - cos(e[i])) * (1 / 3))
        pulls = [_dot(row, e) for row in (self.value / self.level).tolist()]
        squared = _dot(pulls, e)  # e'Se / c
        share = (1.0 - squared) * (1 / (1 - INNER))
        for most in (*near, 1.0):
            share = smaller(share, most)
        share = larger(share, 0.0)
        results = []
        for k, u, least, most, command in zip(
            self.gain.tolist(), self.inputs.tolist(), *self.bounds.tolist(), commands, strict=True
        ):
            limited = smaller(larger(u - _dot(k, e), least), most)
            results.append(share * limited + (1.0 - share) * command)
        return results

    def learn(
        self, dynamics: GPDynamics | PathwisePosterior | PhysicsDynamics, seed: int = 0
    ) -> float:
        """Become the regulator of a model; returns the share of its draws that the law holds [-].

        It does not act where that is less than `trust`, or where there is no law.
        """
        self.level.zero_()
        try:
            inputs = self._holding(dynamics)
            systems = linearised(dynamics, *self._at(inputs), DRAWS, seed)
            self.hold(systems.A[0], systems.B[0], inputs)
            held = self.held(systems)
        except (InputError, np.linalg.LinAlgError) as error:  # the latter of what is not finite
            self.level.zero_()
            logger.info("No regulator: %s", error)
            return 0.0
        share = float(held[1:].mean())
        if not held[0] or share < self.trust:
            self.level.zero_()
            logger.info("No regulator: it holds %.0f %% of the model's draws.", 100 * share)
        return share

    def hold(self, A: Matrix, B: Float[np.ndarray, "X U"], inputs: Float[np.ndarray, " U"]) -> None:
        """Become the regulator of a linear system about the goal, where `inputs` hold it.

        Raises:
            InputError: the inputs are not within their bounds, or do not move what is unstable.
        """
        low, high = self.bounds
        left = np.minimum(high - inputs, inputs - low)
        if (left <= 0).any():
            raise InputError(
                f"The goal is no equilibrium within the bounds: {inputs.tolist()} would hold it, "
                f"which is not between {low.tolist()} and {high.tolist()}; choose another goal."
            )
        R, past = ((high - low) / 2) ** -2.0, self._held.sum(1) > 0
        Q = np.where(past, PAST * self._held @ R, self._costs)
        K, S = riccati(A, B, np.diag(Q), np.diag(R), self.names)
        # the largest K_j e on e'Se = c is sqrt(c K_j S^-1 K_j')
        most = np.einsum("ui,iu->u", K, np.linalg.solve(S, K.T))
        level = np.min((self.room * left) ** 2 / np.maximum(most, np.finfo(float).tiny))
        values = {"gain": K, "value": S, "inputs": inputs, "level": level}
        for name, value in (values | {"goal": self._at(inputs)[0]}).items():
            getattr(self, name).copy_(torch.as_tensor(value))

    def held(self, systems: Linearised) -> Float[np.ndarray, " S"]:
        """Which linear systems about the goal it brings to rest where it acts alone, as 1 or 0."""
        S, K, goal = self.value.numpy(), self.gain.numpy(), self.goal.numpy()
        closed = systems.A - systems.B @ K
        stable = np.abs(np.linalg.eigvals(closed)).max(-1) < 1.0
        left = np.eye(self.width) - np.where(stable[:, None, None], closed, 0.0)
        rest = np.linalg.solve(left, (systems.after - goal)[..., None])[..., 0]
        inside = np.einsum("si,ij,sj->s", rest, S, rest) < INNER * float(self.level)
        return (stable & inside).astype(float)

    def _at(self, inputs: Float[np.ndarray, " U"]) -> tuple[Tensor, Tensor]:
        return torch.from_numpy(self._goal + self._held @ inputs), torch.from_numpy(inputs)

    def _holding(
        self, dynamics: GPDynamics | PathwisePosterior | PhysicsDynamics
    ) -> Float[np.ndarray, " U"]:
        """The inputs by which the mean's next state differs least from the goal."""
        low, high = self.bounds
        inputs = (low + high) / 2
        for _ in range(MOST):
            state, _ = self._at(inputs)
            mean = linearised(dynamics, *self._at(inputs))
            slope = mean.B[0] + (mean.A[0] - np.eye(self.width)) @ self._held
            step = np.linalg.lstsq(slope, state.numpy() - mean.after[0], rcond=None)[0]
            inputs = np.clip(inputs + step, low, high)
            if (np.abs(step) < SETTLED * (high - low)).all():
                break
        return inputs


def _dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    return sum(x * y for x, y in zip(a, b, strict=True))


def riccati(
    A: Matrix,
    B: Float[np.ndarray, "X U"],
    Q: Matrix,
    R: Float[np.ndarray, "U U"],
    names: Sequence[str] = (),
) -> tuple[Float[np.ndarray, "U X"], Matrix]:
    """The gain K of the law u = -K x of least cost of x' = A x + B u, and S of that cost x'Sx.

    `names` are those of the states, for errors.

    Raises:
        InputError: the inputs do not move what is unstable.

    Reference: Anderson & Moore 1990, section 2.4.
    """
    try:
        unmoved = _unmoved(A, B, names)
        S = Q if unmoved else solve_discrete_are(A, B, Q, R)
    except (np.linalg.LinAlgError, ValueError):
        unmoved, S = "its slopes are not finite, or too far apart in size", Q
    if unmoved is not None:
        raise InputError(
            f"No gain stabilises the system: {unmoved}; choose another goal, or an actuator that "
            "moves it."
        )
    return np.linalg.solve(R + B.T @ S @ B, B.T @ S @ A), S


def _unmoved(A: Matrix, B: Float[np.ndarray, "X U"], names: Sequence[str]) -> str | None:
    """The unstable mode that the inputs do not move, by the test of Popov, Belevitch and Hautus."""
    for z in np.linalg.eigvals(A):
        U, sizes, _ = np.linalg.svd(np.hstack([A - z * np.eye(len(A)), B]))
        if abs(z) >= 1.0 - UNMOVED and sizes[-1] <= UNMOVED * sizes[0]:
            i = int(np.abs(U[:, -1]).argmax())
            name = names[i] if names else f"state {i}"
            return f"the inputs do not move the mode of {name}, whose eigenvalue is {abs(z):.3g}"
    return None
