"""Actuators: what lies between a command and the force that it asks for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from jaxtyping import Float

from mcpilco.plant.arithmetic import exp, larger, smaller
from mcpilco.plant.effects.base import Effect, Probe, Scale, Symbol, not_proportional, sizes
from mcpilco.plant.simulation.layout import (
    BIAS,
    DAMPED,
    DEAD_BELOW,
    DEAD_ZONE,
    DELAY,
    FORCE,
    GAIN,
    LAG,
    LIMIT,
    MIDDLE,
    PLAY,
    RANGE,
    RATE,
    STIFF,
    STRONGEST,
    Layout,
    Tables,
)

if TYPE_CHECKING:
    from mcpilco.mjcf import EditedModel


class ActuatorEffect(Effect):
    """One number of an actuator.

    `shape` is its formula, of numbers of any kind (`mcpilco.plant.arithmetic`).
    """

    place = "actuator"
    column: ClassVar[int]
    """of `Tables.actuators`"""

    def targets(self, layout: Layout) -> tuple[str, ...]:
        return layout.actuators

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        tables.actuators[system, at, self.column] += values[0]


def _serves(numbers: Float[np.ndarray, " 15"]) -> bool:
    """Whether an actuator is a servo."""
    return bool(numbers[[STIFF, DAMPED, BIAS]].any())


class ActuatorGain(ActuatorEffect):
    """k times the command; where the nominal gain is not 1, k times that."""

    name = "actuator_gain"
    symbols = (Symbol("k", "-", 1.0, 0.0),)
    column = GAIN

    @staticmethod
    def shape(x: Any, k: Any) -> Any:
        """The force [N or N m] of the command x."""
        return k * x

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        numbers = tables.actuators[system, at]
        numbers[[FORCE, STIFF, DAMPED, BIAS] if _serves(numbers) else GAIN] *= values[0]

    def probes(self, scale: Scale) -> list[Probe]:
        return [sizes(1.02)]

    def write_mjcf(self, model: EditedModel, target: str, values: Sequence[float]) -> None:
        model.multiply_gain(target, values[0])


class ActuatorDeadZone(ActuatorEffect):
    """No force for commands within d of 0; beyond, the command less d."""

    name = "actuator_dead_zone"
    symbols: ClassVar[tuple[Symbol, ...]] = (Symbol("d", "{f}", low=0.0),)
    column = DEAD_ZONE

    @staticmethod
    def shape(x: Any, d_p: Any, d_n: Any) -> Any:
        """The part of a force x that is left [N or N m], of a zone from -d_n to d_p."""
        return larger(x - d_p, 0.0) + smaller(x + d_n, 0.0)

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        tables.actuators[system, at, [DEAD_ZONE, DEAD_BELOW]] += values[0], values[-1]

    def largest(self, scale: Scale) -> Float[np.ndarray, " symbols"]:
        return np.full(len(self.symbols), scale.command)  # which leaves nothing of any command

    def probes(self, scale: Scale) -> list[Probe]:
        return not_proportional(0.01, 0.05, 0.15, unit=scale.command)


class AsymmetricDeadZone(ActuatorDeadZone):
    """No force for commands from -d_n to d_p; beyond, the command less the end of that zone."""

    name = "asymmetric_dead_zone"
    special = ("actuator_dead_zone",)
    repeats = ("actuator_dead_zone",)
    symbols = (Symbol("d_p", "{f}", low=0.0), Symbol("d_n", "{f}", low=0.0))

    def probes(self, scale: Scale) -> list[Probe]:
        ends = [(0.01, 0.05), (0.05, 0.01), (0.02, 0.15), (0.15, 0.02)]
        return [Probe(scale.command * np.array([pair]), proportional=False) for pair in ends]


class ActuatorSaturation(ActuatorEffect):
    """No more force than u_m, in either direction."""

    name = "actuator_saturation"
    symbols = (Symbol("u_m", "{f}", np.inf, 0.0),)
    column = LIMIT

    @staticmethod
    def shape(x: Any, u_m: Any) -> Any:
        """x within its limits."""
        return smaller(larger(x, -u_m), u_m)

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        numbers = tables.actuators[system, at]
        column = STRONGEST if _serves(numbers) else self.column
        numbers[column] = min(numbers[column], values[0])

    def probes(self, scale: Scale) -> list[Probe]:
        return not_proportional(0.95, 0.8, 0.6, 0.4, unit=scale.command)

    def write_mjcf(self, model: EditedModel, target: str, values: Sequence[float]) -> str | None:
        model.limit(target, values[0])
        return None


class CommandRange(ActuatorEffect):
    """No command more than c_m from c_0: known of a plant, so not in the catalogue."""

    name = "command_range"
    symbols = (Symbol("c_m", "command", np.inf, 0.0), Symbol("c_0", "command"))

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        tables.actuators[system, at, [RANGE, MIDDLE]] = values

    def probes(self, scale: Scale) -> list[Probe]:
        return []


class Servo(ActuatorEffect):
    """For a unit of gain, the target less k q + d q' - b_0: known of a plant, as `CommandRange`."""

    name = "servo"
    symbols = (Symbol("k", "-"), Symbol("d", "s"), Symbol("b_0", "command"))

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        tables.actuators[system, at, [STIFF, DAMPED, BIAS]] = values

    def probes(self, scale: Scale) -> list[Probe]:
        return []

    def in_equations(self) -> bool:
        return False  # the program of a model's mean has motors


class ActuatorDelay(ActuatorEffect):
    """The command d seconds ago."""

    name = "actuator_delay"
    symbols = (Symbol("d", "s", low=0.0, high=0.25),)
    column = DELAY

    def probes(self, scale: Scale) -> list[Probe]:
        return not_proportional(0.005, 0.02, 0.05)

    def write_mjcf(self, model: EditedModel, target: str, values: Sequence[float]) -> str | None:
        return model.delay(target, values[0])


class ActuatorLag(ActuatorEffect):
    """T x' = command - x: a first-order lag."""

    name = "actuator_lag"
    symbols = (Symbol("T", "s", low=0.0, high=0.5),)
    column = LAG

    @staticmethod
    def shape(x: Any, goal: Any, since: Any, T: Any) -> Any:
        """The force [N or N m], `since` seconds after it was x on its way to a goal."""
        return goal + (x - goal) * exp(-since / T)

    def probes(self, scale: Scale) -> list[Probe]:
        return not_proportional(0.005, 0.02, 0.06)

    def write_mjcf(self, model: EditedModel, target: str, values: Sequence[float]) -> None:
        model.lag(target, values[0])


class ActuatorRateLimit(ActuatorEffect):
    """The force follows the command by at most r in a second."""

    name = "actuator_rate_limit"
    symbols = (Symbol("r", "{f}/s", np.inf, 0.0),)
    column = RATE
    install = ActuatorSaturation.install

    def in_equations(self) -> bool:
        return False  # it depends on all commands before

    @staticmethod
    def shape(x: Any, goal: Any, since: Any, r: Any) -> Any:
        """The force [N or N m], `since` seconds after it was x on its way to a goal."""
        return smaller(larger(goal, x - r * since), x + r * since)

    def probes(self, scale: Scale) -> list[Probe]:
        return not_proportional(50.0, 20.0, 8.0, 3.0, unit=scale.command)


class Backlash(ActuatorEffect):
    """Play: the force follows the command only when that has moved p away from it."""

    name = "backlash"
    symbols = (Symbol("p", "{f}", low=0.0),)
    column = PLAY

    def in_equations(self) -> bool:
        return False  # it depends on all commands before

    @staticmethod
    def shape(x: Any, p: Any, previous: Any) -> Any:
        """The force nearest to the previous one that is within p of x [N or N m]."""
        return smaller(larger(previous, x - p), x + p)

    def probes(self, scale: Scale) -> list[Probe]:
        return not_proportional(0.01, 0.05, 0.15, unit=scale.command)


def shaping(made: Callable[..., Any] = lambda formula: formula) -> Callable[..., Any]:
    """The function from a command to the force that it asks for, all but delay, lag and rate.

    It takes a row of `Tables.actuators`, a command, and the force that the last command asked for.

    `made` makes each formula callable, as `numba.njit` does.
    """
    times, outside = (made(effect.shape) for effect in (ActuatorGain, ActuatorDeadZone))
    limited, follow = made(ActuatorSaturation.shape), made(Backlash.shape)

    def shaped(actuator, command, previous):
        x = limited(command, actuator[RANGE])
        if actuator[MIDDLE] != 0.0:
            x = actuator[MIDDLE] + limited(command - actuator[MIDDLE], actuator[RANGE])
        x = times(x, actuator[GAIN])
        if actuator[DEAD_ZONE] != 0.0 or actuator[DEAD_BELOW] != 0.0:
            x = outside(x, actuator[DEAD_ZONE], actuator[DEAD_BELOW])
        x = limited(x, actuator[LIMIT])
        if actuator[PLAY] != 0.0:
            x = follow(x, actuator[PLAY], previous)
        return x

    return shaped


def serving(made: Callable[..., Any] = lambda formula: formula) -> Callable[..., Any]:
    """The force that an actuator gives to its joint, of what it is asked for, position and speed.

    It takes a row of `Tables.actuators`, the force that it is asked for, and q and q' of the joint.
    """
    limited = made(ActuatorSaturation.shape)

    def served(actuator, x, q, v):
        x = actuator[FORCE] * x + actuator[BIAS] - actuator[STIFF] * q - actuator[DAMPED] * v
        return limited(x, actuator[STRONGEST])

    return served
