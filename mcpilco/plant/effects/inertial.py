"""Inertial effects: masses, centers of mass and inertias that differ from the drawing's."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Float

from mcpilco.plant.effects.base import MOST, Effect, Place, Probe, Scale, Symbol, sizes
from mcpilco.plant.simulation.layout import Layout, Tables

if TYPE_CHECKING:
    from mcpilco.mjcf import EditedModel

LONGER = 3.0
"""how many times a length may be missing: nobody misreads a ruler by more [-]"""


class InertialEffect(Effect):
    """A number of a body that turns, which differs from the drawing's."""

    place: ClassVar[Place] = "body"
    relative_to: ClassVar[str]
    """the magnitude in `Scale` that sizes are compared with"""
    most: ClassVar[float] = MOST
    """how many times this magnitude may be missing [-]"""

    def targets(self, layout: Layout) -> tuple[str, ...]:
        return layout.turning

    def largest(self, scale: Scale) -> Float[np.ndarray, " symbols"]:
        usual = getattr(scale, self.relative_to)
        return np.array([self.most * usual if usual > 0.0 else np.inf])

    def probes(self, scale: Scale) -> list[Probe]:
        """A size that is small and yet bent too much to be compared with other masses, lengths."""
        usual = getattr(scale, self.relative_to)
        return [Probe(np.array([[0.002 * usual]]), bent=True, usual=10.0)] if usual > 0.0 else []


class BodyMass(InertialEffect):
    """A body is m_d heavier, its shape and density distribution the same: its inertia scales."""

    name = "body_mass"
    relative_to = "mass"
    symbols = (Symbol("m_d", "kg"),)

    def targets(self, layout: Layout) -> tuple[str, ...]:
        return layout.bodies

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        chains = tables.chains
        mass = chains.mass[system, at]
        if mass == 0.0:  # between two joints of one body: a point mass, at its center
            chains.mass[system, at] = max(values[0], 0.0)
            return
        factor = max(1.0 + values[0] / mass, 0.01)
        chains.mass[system, at] *= factor
        chains.inertia[system, at] *= factor

    def write_mjcf(self, model: EditedModel, target: str, values: Sequence[float]) -> None:
        model.inertials.add_mass(target, values[0])


class CenterOfMass(InertialEffect):
    """A body's center of mass is c_d further from its joint, its inertia about it the same."""

    name = "center_of_mass"
    relative_to = "length"
    most = LONGER
    symbols = (Symbol("c_d", "m"),)

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        center = tables.chains.center[system, at]
        length = np.linalg.norm(center)
        if length > 0.0:
            center *= 1.0 + values[0] / length

    def write_mjcf(self, model: EditedModel, target: str, values: Sequence[float]) -> None:
        model.inertials.move_center(target, values[0])


class BodyInertia(InertialEffect):
    """A body's inertia about its joint's axis is I_d larger, its mass and center the same."""

    name = "body_inertia"
    relative_to = "inertia"
    symbols = (Symbol("I_d", "kg m^2"),)

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        axis = tables.chains.axis[at]
        tables.chains.inertia[system, at] += values[0] * np.outer(axis, axis)

    def write_mjcf(self, model: EditedModel, target: str, values: Sequence[float]) -> str | None:
        return model.inertials.add_inertia(target, values[0])


class Armature(InertialEffect):
    """A motor's inertia I_a, reflected to the joint."""

    name = "armature"
    place = "joint"
    relative_to = "inertia"
    symbols = (Symbol("I_a", "{f} s^2/{q}", low=0.0),)

    def targets(self, layout: Layout) -> tuple[str, ...]:
        return layout.guided

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        tables.chains.armature[system, at] += values[0]

    def write_mjcf(self, model: EditedModel, target: str, values: Sequence[float]) -> None:
        model.joint(target).armature += values[0]


class BodyLength(InertialEffect):
    """A body is l_d longer: what it carries is so much further from its joint."""

    name = "body_length"
    relative_to = "length"
    most = LONGER
    symbols = (Symbol("l_d", "m"),)

    def targets(self, layout: Layout) -> tuple[str, ...]:
        return tuple(body for body in super().targets(layout) if body != layout.bodies[-1])

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        for child in np.flatnonzero(tables.chains.parent == at):
            origin = tables.chains.origin[system, child]
            length = np.linalg.norm(origin)
            if length > 0.0:
                origin *= 1.0 + values[0] / length

    def write_mjcf(self, model: EditedModel, target: str, values: Sequence[float]) -> str | None:
        return model.lengthen(target, values[0])


class GravityTilt(Effect):
    """Gravity turned by t about the y axis: a base that is not level."""

    name = "gravity_tilt"
    place = "body"
    symbols = (Symbol("t", "rad", low=-0.5, high=0.5),)

    def targets(self, layout: Layout) -> tuple[str, ...]:
        return layout.bodies[:1]

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        tables.chains.gravity[system] = _turned(tables.chains.gravity[system], values[0])

    def probes(self, scale: Scale) -> list[Probe]:
        return [sizes(0.01)]

    def write_mjcf(self, model: EditedModel, target: str, values: Sequence[float]) -> None:
        model.option.gravity = _turned(np.array(model.option.gravity), values[0])


def _turned(g: Float[np.ndarray, " 3"], angle: float) -> Float[np.ndarray, " 3"]:
    """A vector turned about the y axis [rad]."""
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([cos * g[0] + sin * g[2], g[1], -sin * g[0] + cos * g[2]])
