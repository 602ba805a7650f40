"""What happens between a command and the force that it asks for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from mcpilco.plant.effects.base import Effect, Probe, Scale, Symbol, sizes
from mcpilco.plant.simulation import Layout, Tables
from mcpilco.plant.simulation.tables import DEAD_ZONE, DELAY, GAIN, LAG, LIMIT, PLAY, RANGE


class ActuatorEffect(Effect):
    """One number of an actuator."""

    place = "actuator"
    column: ClassVar[int]
    """of `Tables.actuators`"""

    def targets(self, layout: Layout) -> tuple[str, ...]:
        return layout.actuators

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        tables.actuators[system, at, self.column] += values[0]


class ActuatorGain(ActuatorEffect):
    """k times the command; where the nominal gain is not 1, k times that."""

    name = "actuator_gain"
    symbols = (Symbol("k", "-", 1.0, 0.0),)
    column = GAIN

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        tables.actuators[system, at, GAIN] *= values[0]

    def probes(self, scale: Scale) -> list[Probe]:
        return [sizes(1.02)]


class ActuatorDeadZone(ActuatorEffect):
    """No force for commands within d of 0; beyond, the command less d."""

    name = "actuator_dead_zone"
    symbols = (Symbol("d", "{f}", low=0.0),)
    column = DEAD_ZONE

    def probes(self, scale: Scale) -> list[Probe]:
        return [_nonlinear(part * scale.command) for part in (0.01, 0.05, 0.15)]


class ActuatorSaturation(ActuatorEffect):
    """No more force than u_m, in either direction."""

    name = "actuator_saturation"
    symbols = (Symbol("u_m", "{f}", np.inf, 0.0),)
    column = LIMIT

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        numbers = tables.actuators[system, at]
        numbers[self.column] = min(numbers[self.column], values[0])

    def probes(self, scale: Scale) -> list[Probe]:
        return [_nonlinear(part * scale.command) for part in (0.95, 0.8, 0.6, 0.4)]


class CommandRange(ActuatorSaturation):
    """No command beyond c_m, in either direction: known of a plant, so not in the catalogue."""

    name = "command_range"
    symbols = (Symbol("c_m", "command", np.inf, 0.0),)
    column = RANGE


class ActuatorDelay(ActuatorEffect):
    """The command d seconds ago."""

    name = "actuator_delay"
    symbols = (Symbol("d", "s", low=0.0, high=0.25),)
    column = DELAY

    def probes(self, scale: Scale) -> list[Probe]:
        return [_nonlinear(delay) for delay in (0.005, 0.02, 0.05)]


class ActuatorLag(ActuatorEffect):
    """T x' = command - x: a first-order lag."""

    name = "actuator_lag"
    symbols = (Symbol("T", "s", low=0.0, high=0.5),)
    column = LAG

    def probes(self, scale: Scale) -> list[Probe]:
        return [_nonlinear(lag) for lag in (0.005, 0.02, 0.06)]


class Backlash(ActuatorEffect):
    """Play: the force follows the command only when that has moved p away from it."""

    name = "backlash"
    symbols = (Symbol("p", "{f}", low=0.0),)
    column = PLAY

    def probes(self, scale: Scale) -> list[Probe]:
        return [_nonlinear(part * scale.command) for part in (0.01, 0.05, 0.15)]


def _nonlinear(value: float) -> Probe:
    """A size whose signature does not simply grow with it."""
    return Probe(np.array([[value]]), proportional=False)
