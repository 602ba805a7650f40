"""Our policy as a controller of the checkout of double_pendulum.

Loaded by the boards' own scripts, in the checkout's environment: `double_pendulum` is theirs.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from double_pendulum.controller.abstract_controller import AbstractController
from realaigym.equations import DT, JOINT, nominal_row
from realaigym.motion import ALL, OURS, Gaussians, motion
from realaigym.observer import Observer
from realaigym.regulator import Regulator, blended

from envs.plants import BOARD, PLANTS

TUBE = np.array([0.1, 0.1, 1.0, 1.0])
"""how far the machine may be from the plan of the thrifty policy [rad, rad/s]"""


class Controller(AbstractController):
    """The policies of a run on the observed state, and a regulator near the top.

    From hanging the thrifty policy acts, while the machine goes as planned: as this policy and the
    nominal plant would. From the first step that is outside of a tube about the plan, the robust
    policy acts for the rest of the motion. Without a thrifty policy it acts from the beginning.
    """

    def __init__(
        self,
        robot: str,
        policy: Path,
        limit: float,
        room: float,
        regulated: bool,
        observed: bool,
        thrifty: Path | None = None,
        gentle: float | None = None,
    ) -> None:
        """Of a robot, the files of its policies, and what belongs to them.

        Args:
            robot: of the boards.
            policy: the robust one.
            limit: largest torque of the regulators [N m].
            room: of the regulator behind the robust policy [-].
            regulated: whether there is such a regulator.
            observed: whether the policies act on the state that the observer tells.
            thrifty: the policy of the motion from hanging.
            gentle: room of the regulator behind that policy; None: as the robust one's [-].
        """
        super().__init__()
        self.joint, self.robust = JOINT[robot], Gaussians.read(policy)
        plant = PLANTS[f"mcpilco/{robot.capitalize()}-v0"]().where(**BOARD)
        row = nominal_row(plant)
        self.regulator = Regulator(plant, DT, limit, room) if regulated else None
        self.observer = Observer(row, self.joint, DT) if observed else None
        self.thrifty = None if thrifty is None else Gaussians.read(thrifty)
        self.gentle = Regulator(plant, DT, limit, room if gentle is None else gentle)
        self.plan = np.empty((0, 4))
        if self.thrifty is not None:
            self.plan, _ = motion(self.thrifty, self.gentle, row, self.joint, ALL)
        self._step: int | None = 0

    def init_(self) -> None:
        self._step = 0
        if self.observer is not None:
            self.observer.reset()

    def _as_planned(self, state: Any) -> bool:
        """Whether the machine has been in the tube about the plan up to now."""
        if self._step is None or self._step >= len(self.plan):
            self._step = None
            return False
        away = np.abs(state - self.plan[self._step])
        self._step = self._step + 1 if (away < TUBE).all() else None
        return self._step is not None

    def get_control_output_(self, x: Any, t: float | None = None) -> list[float]:
        state = np.asarray(x, dtype=float)
        if self.observer is not None:
            state = self.observer(state)
        acting = self.robust, self.regulator
        if self._as_planned(state):
            acting = self.thrifty, self.gentle
        torques = [0.0, 0.0]
        torques[self.joint] = blended(*acting, state[OURS])
        if self.observer is not None:
            self.observer.told(torques[self.joint])
        return torques


def made(told: Path) -> tuple[Controller, dict[str, str]]:
    """The controller that a file describes, and its entry in a board."""
    entry = json.loads(told.read_text())
    name = entry.pop("name").replace("-", "_")  # as the file of the controller has it
    for policy in {"policy", "thrifty"} & set(entry):
        entry[policy] = told.parent / entry[policy]
    controller = Controller(**entry)
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
