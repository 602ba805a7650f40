"""A compiled MuJoCo model that effects are written into: its numbers, without compiling it anew."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np

from mcpilco.mjcf.edited_model import EditedModel


class EditedNumbers(EditedModel):
    """A compiled model; its names are those of its plant's layout."""

    @property
    def option(self) -> Any:
        return self._model.opt

    def joint(self, name: str) -> Any:
        return _Joint(self._model, self._layout.joints.index(name))

    def actuator(self, name: str) -> Any:
        return self._model.actuator(self._layout.actuators.index(name))

    def body(self, number: int) -> Any:
        return self._model.body(number)

    def geoms(self) -> Iterable[Any]:
        return map(self._model.geom, range(self._model.ngeom))

    def pairs(self) -> Iterable[Any]:
        return map(self._model.pair, range(self._model.npair))

    def rests_at(self, joint: str, rest: float) -> None:
        number = self._model.dof_jntid[self._layout.joints.index(joint)]
        self._model.qpos_spring[self._model.jnt_qposadr[number]] = rest

    def finish(self) -> None:
        super().finish()
        self.inertials.write_into(self._model)
        mujoco.mj_setConst(self._model, mujoco.MjData(self._model))


class _Joint:
    """The numbers of a degree of freedom, by the names that a specification has for them."""

    def __init__(self, model: mujoco.MjModel, dof: int) -> None:
        put = object.__setattr__
        put(self, "_model", model)
        put(self, "_dof", dof)
        put(self, "_number", int(model.dof_jntid[dof]))

    def _place(self, name: str) -> tuple[tuple[np.ndarray, int], ...]:
        m, dof, j = self._model, self._dof, self._number
        return {
            "damping": ((m.dof_damping, dof), (m.dof_dampingpoly, dof)),
            "stiffness": ((m.jnt_stiffness, j), (m.jnt_stiffnesspoly, j)),
            "frictionloss": ((m.dof_frictionloss, dof),),
            "armature": ((m.dof_armature, dof),),
            "solimp_friction": ((m.dof_solimp, dof),),
            "solref_friction": ((m.dof_solref, dof),),
        }[name]

    def __getattr__(self, name: str) -> Any:
        numbers = np.concatenate([np.ravel(array[at]) for array, at in self._place(name)])
        return float(numbers[0]) if len(numbers) == 1 else numbers

    def __setattr__(self, name: str, value: Any) -> None:
        first, *more = self._place(name)
        numbers = np.ravel(value)
        if more:
            first[0][first[1]], (array, at) = numbers[0], more[0]
            array[at] = numbers[1:]
        else:
            first[0][first[1]] = numbers if len(numbers) > 1 else numbers[0]
