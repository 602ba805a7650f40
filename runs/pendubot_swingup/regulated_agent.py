"""MC-PILCO of a double pendulum, with a linear regulator of what it has learned near the top."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import gymnasium
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
from mcpilco.search import Candidate, Problem, SearchResult
from mcpilco.sensing import Perception

ENVS = {robot: f"mcpilco/{robot.capitalize()}-v0" for robot in JOINT}
LIMIT = 6.0
"""largest torque [N m]"""
SEEN = 4.0
"""torque that the regulator may ask for in the region that the cost sees, to the limit [-]"""


class Agent(MCPILCO):
    """MC-PILCO of one of the double pendulums, with the cost of its env."""

    def __init__(self, robot: str, sight: int, *, config: Config, seed: int, **env: Any) -> None:
        """An agent that has learned nothing yet.

        Args:
            robot: `pendubot` or `acrobot`.
            sight: how far particles go [steps].
            config: the numbers.
            seed: of everything random.
            **env: keywords of the env.
        """
        self._sight = sight
        made = gymnasium.make(ENVS[robot], torque_limit=LIMIT, **env)
        super().__init__("SumOfGaussians", made, config=config, seed=seed)

    def _problem(self, trial: int, perception: Perception | None) -> Problem:
        return replace(super()._problem(trial, perception), horizon=self._sight)


class KnowingAgent(Agent):
    """An agent whose model has the pendulum's equations as its mean.

    After each fit the cost is that of the plant as it is known then, with a part for the energy and
    one for the region of a regulator.
    """

    def __init__(
        self,
        robot: str,
        sight: int,
        *,
        weights: Mapping[str, float],
        config: Config,
        seed: int,
        **env: Any,
    ) -> None:
        """An agent that has learned nothing yet.

        Args:
            robot: `pendubot` or `acrobot`.
            sight: how far particles go [steps].
            weights: of the parts of the `SwingCost`.
            config: the numbers; `config.model.plant` is the nominal plant.
            seed: of everything random.
            **env: keywords of the env.
        """
        assert isinstance(config.model.plant, Mapping), "the numbers of the nominal plant"
        self._robot, self._weights = robot, weights
        self._units = config.policy.regulator_units
        nominal = envs.PLANTS[ENVS[robot]]().where(**config.model.plant["parameters"])
        self._cost_now = Replaceable(self._cost_of(nominal, env["dt"]))
        env["cost"] = self._cost_now
        super().__init__(robot, sight, config=config, seed=seed, **env)

    def _cost_of(self, plant: Plant, dt: float) -> SwingCost:
        """The cost of a plant whose torques are held for dt [s]."""
        scales, costs = RECIPES[self._robot].lengthscales, STATE_COST
        if self._units:
            costs = tuple((LIMIT / unit) ** 2 for unit in self._units)
        seen = SeenRegulator(plant, dt, LIMIT, SEEN, costs)
        return SwingCost(nominal_row(plant), seen, JOINT[self._robot], scales, **self._weights)

    def _search(
        self, trial: int, perception: Perception | None, events: Callback
    ) -> SearchResult[Candidate]:
        physics, dt = self.model.physics, self.task.dt
        assert physics is not None, "the mean is physics"
        self._cost_now.now = self._cost_of(physics.plant.where(**physics.values), dt)
        return super()._search(trial, perception, events)
