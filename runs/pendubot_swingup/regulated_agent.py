"""MC-PILCO whose policy hands over to a linear regulator of the plant that it has learned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import gymnasium
from jaxtyping import Float
from realaigym.equations import JOINT, nominal_row
from realaigym.recipes import RECIPES
from realaigym.regulator import Regulator, blended
from realaigym.swing_cost import Replaceable, SwingCost
from torch import Tensor

import envs
from mcpilco import MCPILCO
from mcpilco.config import Config
from mcpilco.logbook import Callback
from mcpilco.plant import Plant
from mcpilco.policies import SumOfGaussians
from mcpilco.search import Candidate, SearchResult
from mcpilco.sensing import Perception

ENVS = {robot: f"mcpilco/{robot.capitalize()}-v0" for robot in JOINT}
LIMIT = 6.0
"""largest torque [N m]"""
ROOM = 2.0
"""torque that the regulator may ask for in its region, to the limit [-]"""
SEEN = 4.0
"""the same of the region that the cost sees [-]"""


@dataclass(frozen=True)
class Regulated:
    """A policy, and a regulator near the top."""

    policy: SumOfGaussians
    regulator: Regulator

    def __call__(self, states: Float[Tensor, "*b 4"]) -> Float[Tensor, "*b 1"]:
        """The torques for some states [N m]."""
        torques, rows = self.policy(states), states.reshape(-1, 4).numpy()
        for i, (row, torque) in enumerate(zip(rows, torques.flatten().tolist(), strict=True)):
            torques.view(-1)[i] = blended(lambda _, torque=torque: torque, self.regulator, row)
        return torques


class Agent(MCPILCO):
    """MC-PILCO of one of the double pendulums, with its equations as the model's mean.

    After each fit the cost and the regulator are those of the plant as it is known then. Particles
    do not see the regulator; the cost has a part for its region.
    """

    def __init__(
        self,
        robot: str,
        weights: Mapping[str, float],
        regulated: bool,
        *,
        config: Config,
        seed: int,
        **env: Any,
    ) -> None:
        """An agent that has learned nothing yet.

        Args:
            robot: `pendubot` or `acrobot`.
            weights: of the parts of the `SwingCost`.
            regulated: whether there is a regulator.
            config: the numbers; `config.model.plant` is the nominal plant.
            seed: of everything random.
            **env: keywords of the env.
        """
        assert isinstance(config.model.plant, Mapping), "the numbers of the nominal plant"
        self._robot, self._weights, self._regulated = robot, weights, regulated
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
        if isinstance(self.policy, Regulated):
            self.policy = self.policy.policy
        known = physics.plant.where(**physics.values)
        self._cost_now.now = self._cost_of(known, dt)
        found = super()._search(trial, perception, events)
        if not self._regulated:
            return found
        policy = Regulated(found.best.policy, Regulator(known, dt, LIMIT, ROOM))
        return replace(found, best=replace(found.best, policy=policy))
