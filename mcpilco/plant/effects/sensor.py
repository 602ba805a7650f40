"""Sensors: what lies between a state and its measurement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from mcpilco.plant.effects.base import Effect, Probe, Scale, Symbol, not_proportional, sizes
from mcpilco.plant.simulation.layout import (
    COSINE,
    FILTER,
    LATENCY,
    OFFSET,
    SCALE,
    SINE,
    Layout,
    Tables,
)


class SensorEffect(Effect):
    """One number of a state's sensor."""

    place = "sensor"
    column: ClassVar[int]
    """of `Tables.sensors`"""

    def targets(self, layout: Layout) -> tuple[str, ...]:
        return layout.states

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        tables.sensors[system, at, self.column] += values[0]

    def units(self, layout: Layout, target: str) -> tuple[str, ...]:
        unit = layout.unit_of(target)[0]
        if layout.states.index(target) % 2:
            unit += "/s"
        return tuple(symbol.unit.format(x=unit) for symbol in self.symbols)


class SensorOffset(SensorEffect):
    """The state plus o."""

    name = "sensor_offset"
    symbols = (Symbol("o", "{x}"),)
    column = OFFSET

    def probes(self, scale: Scale) -> list[Probe]:
        return [sizes(0.02 * scale.signal)]


class SensorScale(SensorEffect):
    """k times the state."""

    name = "sensor_scale"
    symbols = (Symbol("k", "-", 1.0, 0.0),)
    column = SCALE

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        tables.sensors[system, at, SCALE] *= values[0]

    def probes(self, scale: Scale) -> list[Probe]:
        return [sizes(1.01)]


class SensorDelay(SensorEffect):
    """The state d seconds ago."""

    name = "sensor_delay"
    symbols = (Symbol("d", "s", low=0.0, high=0.06),)
    column = LATENCY

    def in_equations(self) -> bool:
        return False  # a state of the model would have to hold past states

    def probes(self, scale: Scale) -> list[Probe]:
        return not_proportional(0.005, 0.02)


class SensorLag(SensorEffect):
    """T y' = state - y: the filter of a sensor, or of what differentiates its readings."""

    name = "sensor_lag"
    symbols = (Symbol("T", "s", low=0.0, high=0.1),)
    column = FILTER

    def in_equations(self) -> bool:
        return False  # a state of the model would have to hold past states

    def probes(self, scale: Scale) -> list[Probe]:
        return not_proportional(0.003, 0.02)


class EccentricEncoder(SensorEffect):
    """The angle plus s sin(angle) + c cos(angle): an encoder's disc that is not on its axis."""

    name = "eccentric_encoder"
    symbols = (Symbol("s", "rad"), Symbol("c", "rad"))

    def targets(self, layout: Layout) -> tuple[str, ...]:
        return tuple(layout.states[2 * layout.joints.index(name)] for name in layout.hinges)

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        tables.sensors[system, at, [SINE, COSINE]] += values

    def in_equations(self) -> bool:
        return False  # no formula gives the angle of a reading

    def probes(self, scale: Scale) -> list[Probe]:
        return [Probe(np.array([[0.01, 0.0], [0.0, 0.01]]))]
