"""Our policy as a controller of the checkout of double_pendulum.

Loaded by the boards' own scripts, in the checkout's environment: `double_pendulum` is theirs.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from double_pendulum.controller.abstract_controller import AbstractController
from realaigym.equations import nominal_row
from realaigym.observer import Observer
from realaigym.regulator import Regulator, blended

from envs.plants import BOARD, PLANTS
from mcpilco.agent import NumpyPolicy

DT = 0.002
"""time between two calls of a controller [s]"""
JOINT = {"pendubot": 0, "acrobot": 1}
"""which joint has the motor"""
ORDER = [0, 2, 1, 3]
"""where our states are among theirs: they put the angles first"""


class Controller(AbstractController):
    """The policy of a run on the observed state, and the regulator near the top."""

    def __init__(
        self, robot: str, policy: Path, limit: float, regulated: bool, observed: bool
    ) -> None:
        super().__init__()
        self.joint, self.exported = JOINT[robot], NumpyPolicy(policy)
        plant = PLANTS[f"mcpilco/{robot.capitalize()}-v0"]().where(**BOARD)
        self.regulator = Regulator(plant, DT, limit) if regulated else None
        self.observer = Observer(nominal_row(plant), self.joint, DT) if observed else None

    def _policy(self, state: Any) -> float:
        return float(self.exported(state)[0])

    def init_(self) -> None:
        self.exported.reset()
        if self.observer is not None:
            self.observer.reset()

    def get_control_output_(self, x: Any, t: float | None = None) -> list[float]:
        state = np.asarray(x, dtype=float)
        if self.observer is not None:
            state = self.observer(state)
        torques = [0.0, 0.0]
        torques[self.joint] = blended(self._policy, self.regulator, state[ORDER])
        if self.observer is not None:
            self.observer.told(torques[self.joint])
        return torques


def made(told: Path) -> tuple[Controller, dict[str, str]]:
    """The controller that a file describes, and its entry in a board."""
    entry = json.loads(told.read_text())
    name = entry.pop("name").replace("-", "_")  # as the file of the controller has it
    controller = Controller(**{**entry, "policy": told.parent / entry["policy"]})
    controller.init()
    config = {
        "csv_path": f"{name}/sim_swingup.csv",
        "name": name,
        "simple_name": name,
        "short_description": "MC-PILCO of the package mcpilco",
        "readme_path": f"readmes/{name}.md",
        "username": "mcpilco",
    }
    return controller, config
