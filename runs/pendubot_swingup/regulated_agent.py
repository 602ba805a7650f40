"""MC-PILCO whose cost shows the way to the region of a linear regulator of the learned plant."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
from realaigym.equations import JOINT, nominal_row
from realaigym.recipes import RECIPES
from realaigym.regulator import Regulator
from realaigym.swing_cost import Replaceable, SwingCost

import envs
from mcpilco import MCPILCO
from mcpilco.config import Config
from mcpilco.logbook import Callback
from mcpilco.plant import Plant
from mcpilco.search import Candidate, SearchResult
from mcpilco.sensing import Perception

ENVS = {robot: f"mcpilco/{robot.capitalize()}-v0" for robot in JOINT}
LIMIT = 6.0
"""largest torque [N m]"""
SEEN = 4.0
"""torque that the regulator may ask for in the region that the cost sees, to the limit [-]"""


class Agent(MCPILCO):
    """MC-PILCO of one of the double pendulums, with its equations as the model's mean.

    After each fit the cost is that of the plant as it is known then, with a part for the region of
    a regulator; the policy has a regulator of its own where `config.policy.regulator` says so.
    """

    def __init__(
        self,
        robot: str,
        weights: Mapping[str, float],
        *,
        config: Config,
        seed: int,
        **env: Any,
    ) -> None:
        """An agent that has learned nothing yet.

        Args:
            robot: `pendubot` or `acrobot`.
            weights: of the parts of the `SwingCost`.
            config: the numbers; `config.model.plant` is the nominal plant.
            seed: of everything random.
            **env: keywords of the env.
        """
        assert isinstance(config.model.plant, Mapping), "the numbers of the nominal plant"
        self._robot, self._weights = robot, weights
        nominal = envs.PLANTS[ENVS[robot]]().where(**config.model.plant["parameters"])
        self._cost_now = Replaceable(self._cost_of(nominal, env["dt"]))
        made = gymnasium.make(ENVS[robot], cost=self._cost_now, torque_limit=LIMIT, **env)
        super().__init__("SumOfGaussians", made, config=config, seed=seed)

    def _cost_of(self, plant: Plant, dt: float) -> SwingCost:
        """The cost of a plant whose torques are held for dt [s]."""
        scales, seen = RECIPES[self._robot].lengthscales, Regulator(plant, dt, LIMIT, SEEN)
        return SwingCost(nominal_row(plant), seen, JOINT[self._robot], scales, **self._weights)

    def _search(
        self, trial: int, perception: Perception | None, events: Callback
    ) -> SearchResult[Candidate]:
        physics, dt = self.model.physics, self.task.dt
        assert physics is not None, "the mean is physics"
        self._cost_now.now = self._cost_of(physics.plant.where(**physics.values), dt)
        return super()._search(trial, perception, events)
