"""Inertial effects: masses, centers of mass and inertias that differ from the drawing's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from mcpilco.plant.effects.base import MOST, Effect, Probe, Scale, Symbol
from mcpilco.plant.simulation.layout import Layout, Tables

if TYPE_CHECKING:
    from mcpilco.plant.corrected_mjcf import CorrectedModel


class BodyMass(Effect):
    """A body is m_d heavier, its shape and density distribution the same: its inertia scales."""

    name = "body_mass"
    place = "body"
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

    def largest(self, scale: Scale) -> Float[np.ndarray, " symbols"]:
        return np.array([MOST * scale.mass if scale.mass > 0.0 else np.inf])

    def probes(self, scale: Scale) -> list[Probe]:
        return [_bent(0.002 * scale.mass)] if scale.mass > 0.0 else []

    def write_mjcf(self, model: CorrectedModel, target: str, values: Sequence[float]) -> None:
        model.inertials.add_mass(target, values[0])


class CenterOfMass(Effect):
    """A body's center of mass is c_d further from its joint, its inertia about it the same."""

    name = "center_of_mass"
    place = "body"
    symbols = (Symbol("c_d", "m"),)

    def targets(self, layout: Layout) -> tuple[str, ...]:
        pairs = zip(layout.bodies, layout.slides, strict=True)
        return tuple(body for body, slides in pairs if not slides)

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        center = tables.chains.center[system, at]
        length = np.linalg.norm(center)
        if length > 0.0:
            center *= 1.0 + values[0] / length

    def largest(self, scale: Scale) -> Float[np.ndarray, " symbols"]:
        return np.array([MOST * scale.length if scale.length > 0.0 else np.inf])

    def probes(self, scale: Scale) -> list[Probe]:
        return [_bent(0.002 * scale.length)] if scale.length > 0.0 else []

    def write_mjcf(self, model: CorrectedModel, target: str, values: Sequence[float]) -> None:
        model.inertials.move_center(target, values[0])


class BodyInertia(Effect):
    """A body's inertia about its joint's axis is I_d larger, its mass and center the same."""

    name = "body_inertia"
    place = "body"
    symbols = (Symbol("I_d", "kg m^2"),)

    def targets(self, layout: Layout) -> tuple[str, ...]:
        pairs = zip(layout.bodies, layout.slides, strict=True)
        return tuple(body for body, slides in pairs if not slides)

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        axis = tables.chains.axis[at]
        tables.chains.inertia[system, at] += values[0] * np.outer(axis, axis)

    def largest(self, scale: Scale) -> Float[np.ndarray, " symbols"]:
        return np.array([MOST * scale.inertia])

    def probes(self, scale: Scale) -> list[Probe]:
        return [_bent(0.002 * scale.inertia)]

    def write_mjcf(self, model: CorrectedModel, target: str, values: Sequence[float]) -> str | None:
        return model.inertials.add_inertia(target, values[0])


class Armature(Effect):
    """A motor's inertia I_a, reflected to the joint."""

    name = "armature"
    place = "joint"
    symbols = (Symbol("I_a", "{f} s^2/{q}", low=0.0),)

    def targets(self, layout: Layout) -> tuple[str, ...]:
        return layout.joints

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        tables.chains.armature[system, at] += values[0]

    def largest(self, scale: Scale) -> Float[np.ndarray, " symbols"]:
        return np.array([MOST * scale.inertia])

    def probes(self, scale: Scale) -> list[Probe]:
        return [_bent(0.002 * scale.inertia)]

    def write_mjcf(self, model: CorrectedModel, target: str, values: Sequence[float]) -> None:
        model.joint(target).armature += values[0]


def _bent(value: float) -> Probe:
    """A size that is small and yet bent too much to be compared with other masses and lengths."""
    return Probe(np.array([[value]]), bent=True, usual=10.0)
