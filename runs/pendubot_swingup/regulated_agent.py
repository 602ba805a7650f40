"""MC-PILCO whose cost shows the way to the region of a linear regulator of the learned plant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import torch
from jaxtyping import Float
from realaigym.equations import JOINT, nominal_row
from realaigym.recipes import RECIPES
from realaigym.regulator import STATE_COST
from realaigym.regulator import Regulator as SeenRegulator
from realaigym.swing_cost import Replaceable, SwingCost

import envs
from mcpilco import MCPILCO
from mcpilco.config import Config
from mcpilco.logbook import Callback
from mcpilco.plant import Plant
from mcpilco.policies import Regulator
from mcpilco.search import Candidate, Problem, SearchResult
from mcpilco.sensing import Perception

ENVS = {robot: f"mcpilco/{robot.capitalize()}-v0" for robot in JOINT}
LIMIT = 6.0
"""largest torque [N m]"""
SEEN = 4.0
"""torque that the regulator may ask for in the region that the cost sees, to the limit [-]"""


class CountedRegulator(Regulator):
    """The package's regulator, in whose cost each state counts in a unit that is chosen.

    An error of one such unit costs as much as the largest torque.
    """

    def __init__(self, units: Float[np.ndarray, " X"], *arguments: Any) -> None:
        """One that does not act yet.

        Args:
            units: of each state, in its unit.
            *arguments: those of `Regulator`.
        """
        super().__init__(*arguments)
        self.units = units

    def hold(
        self,
        A: Float[np.ndarray, "X X"],
        B: Float[np.ndarray, "X U"],
        inputs: Float[np.ndarray, " U"],
    ) -> None:
        """Become the regulator of a linear system about the goal, see `Regulator.hold`."""
        # e = D z: z' = D^-1 A D z + D^-1 B u, and u = -K z = -(K D^-1) e
        D = self.units
        super().hold(A / D[:, None] * D, B / D[:, None], inputs)
        self.gain.div_(torch.from_numpy(D))
        self.value.div_(torch.from_numpy(np.outer(D, D)))


class Agent(MCPILCO):
    """MC-PILCO of one of the double pendulums, with its equations as the model's mean.

    After each fit the cost is that of the plant as it is known then, with a part for the region of
    a regulator; the policy has a regulator of its own where `config.policy.regulator` says so.
    """

    def __init__(
        self,
        robot: str,
        weights: Mapping[str, float],
        units: tuple[float, float] | None,
        sight: int,
        *,
        config: Config,
        seed: int,
        **env: Any,
    ) -> None:
        """An agent that has learned nothing yet.

        Args:
            robot: `pendubot` or `acrobot`.
            weights: of the parts of the `SwingCost`.
            units: in which regulators count angles and velocities [rad, rad/s]; None: in those
                that the policy's and that of the cost have of their own.
            sight: how far particles go [steps].
            config: the numbers; `config.model.plant` is the nominal plant.
            seed: of everything random.
            **env: keywords of the env.
        """
        assert isinstance(config.model.plant, Mapping), "the numbers of the nominal plant"
        self._robot, self._weights, self._units, self._sight = robot, weights, units, sight
        nominal = envs.PLANTS[ENVS[robot]]().where(**config.model.plant["parameters"])
        self._cost_now = Replaceable(self._cost_of(nominal, env["dt"]))
        made = gymnasium.make(ENVS[robot], cost=self._cost_now, torque_limit=LIMIT, **env)
        super().__init__("SumOfGaussians", made, config=config, seed=seed)
        if units is not None and (room := config.policy.regulator):
            counted = CountedRegulator(np.tile(units, 2), room, self.task, self.low, self.high)
            self.policy.regulator = counted

    def _cost_of(self, plant: Plant, dt: float) -> SwingCost:
        """The cost of a plant whose torques are held for dt [s]."""
        scales, costs = RECIPES[self._robot].lengthscales, STATE_COST
        if self._units is not None:
            costs = 2 * tuple((LIMIT / unit) ** 2 for unit in self._units)
        seen = SeenRegulator(plant, dt, LIMIT, SEEN, costs)
        return SwingCost(nominal_row(plant), seen, JOINT[self._robot], scales, **self._weights)

    def _problem(self, trial: int, perception: Perception | None) -> Problem:
        return replace(super()._problem(trial, perception), horizon=self._sight)

    def _search(
        self, trial: int, perception: Perception | None, events: Callback
    ) -> SearchResult[Candidate]:
        physics, dt = self.model.physics, self.task.dt
        assert physics is not None, "the mean is physics"
        self._cost_now.now = self._cost_of(physics.plant.where(**physics.values), dt)
        return super()._search(trial, perception, events)
