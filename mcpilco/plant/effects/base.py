"""The base of all effects: a named formula, its parameters, and how it enters a simulation."""

from __future__ import annotations

import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from jaxtyping import Bool, Float

from mcpilco.plant.simulation.layout import Layout, Tables

if TYPE_CHECKING:
    from mcpilco.mjcf import EditedModel

Place = Literal["actuator", "joint", "body", "sensor", "contact"]

MOST = 30.0
"""how many times the usual force or mass may be missing; beyond, a joint would be held fast [-]"""
OUTSIDE = {
    "actuator": "apply it to the command before that is written to ctrl",
    "joint": "add its force to qfrc_applied before each step",
    "body": "change the body's geometry instead",
    "sensor": "apply it to what is measured",
    "contact": "change the geoms instead",
}
"""the remedy for an effect that MJCF cannot say, by its place"""


@dataclass(frozen=True)
class Symbol:
    """A parameter of an effect."""

    name: str
    """as reports and files write it"""
    unit: str
    """{q} stands for the unit of the position at its joint, {f} for that of the force"""
    neutral: float = 0.0
    """value at which the effect changes nothing"""
    low: float = -np.inf
    """least value that makes physical sense"""
    high: float = np.inf
    """largest one"""
    reported: bool = True
    """whether a report shows it; False for what only smooths the formula"""
    within: tuple[str, float, float] | None = None
    """a magnitude of `Scale`, and the multiples of it between which the value is plausible"""

    def bounds(self, scale: Scale) -> tuple[float, float]:
        """Least and largest value that is plausible in some recordings."""
        if self.within is None:
            return self.low, self.high
        of, least, most = self.within
        usual = getattr(scale, of)
        low = max(self.low, least * usual)
        return low, max(min(self.high, most * usual), low)


@dataclass(frozen=True)
class Scale:
    """Typical magnitudes at a target in some recordings, from which plausible sizes follow."""

    position: float
    """largest |q| of the joint [m or rad]"""
    velocity: float
    """rms of q' [m/s or rad/s]"""
    force: float
    """rms of the forces at the joint [N or N m]"""
    command: float
    """largest |command| of the actuator; of the first where the target is none [its unit]"""
    signal: float
    """rms of the state where the target is one, else of q [its unit]"""
    inertia: float
    """of the joint: M_jj [kg or kg m^2]"""
    mass: float
    """of the body [kg]"""
    length: float
    """from the joint to the center of mass of the body [m]"""
    dt: float
    """sampling time [s]"""

    @property
    def way(self) -> float:
        """That the joint takes in a tenth of a second [m or rad]."""
        return 0.1 * self.velocity

    @property
    def wave(self) -> float:
        """Wave number of which one wave spans the places that the joint was at [1/m or 1/rad]."""
        return math.pi / max(self.position, 1e-6)

    @property
    def stiffness(self) -> float:
        """Of a spring on which the joint would swing as fast as can be seen [N/m or N m/rad]."""
        return self.inertia * (math.pi / self.dt) ** 2


@dataclass(frozen=True)
class Probe:
    """Small parameter values of an effect, at which a simulation shows its signature."""

    values: Float[np.ndarray, "n symbols"]
    """n sizes, whose signatures may be mixed"""
    proportional: bool = True
    """whether a mix of signatures is that of the mixed values"""
    bent: bool = False
    """whether signatures are extrapolated to infinitesimal sizes, from whole and half sizes"""
    usual: float = 1.0
    """how many times as large an effect is that should be noticed"""


class Effect(ABC):
    """A named physical effect: one formula, and one place where it acts."""

    name: ClassVar[str]
    """public vocabulary, as in `coulomb_friction`"""
    place: ClassVar[Place]
    """what its target is"""
    symbols: ClassVar[tuple[Symbol, ...]]
    """its parameters, in the order of their values"""
    special: ClassVar[tuple[str, ...]] = ()
    """effects that it becomes for some of its values"""
    repeats: ClassVar[tuple[str, ...]] = ()
    """effects beside which, at the same target, it says a part of the same again"""

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other)

    def __hash__(self) -> int:
        return hash(type(self))

    @abstractmethod
    def targets(self, layout: Layout) -> tuple[str, ...]:
        """Where in a plant it can act, by name."""

    def in_equations(self) -> bool:
        """Whether the equations of motion that a model takes as its mean can say it."""
        return True

    def write_mjcf(self, model: EditedModel, target: str, values: Sequence[float]) -> str | None:
        """Writes itself into an MJCF model; where it cannot, returns what to do instead, or why.

        The target is a joint, body, actuator or state; there is a value for each of its symbols.
        """
        return OUTSIDE[self.place]

    @abstractmethod
    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        """Adds its action to the tables of one system.

        `at` is its row among the laws, or the number of its body, input or state; there is a value
        for each of its symbols.
        """

    @abstractmethod
    def probes(self, scale: Scale) -> list[Probe]:
        """Sizes that are small but noticeable, different in kind."""

    def largest(self, scale: Scale) -> Float[np.ndarray, " symbols"]:
        """Values beyond which it explains nothing, however well it fits."""
        return np.full(len(self.symbols), np.inf)

    def made_of(self, parts: Mapping[str, Sequence[float]]) -> list[float] | None:
        """Values with which it does what others do together, by their names; None: it cannot."""
        return None

    @property
    def file(self) -> str:
        """Name of the file of its class, which a correction refers to where it is a user's own."""
        return Path(getattr(sys.modules.get(type(self).__module__), "__file__", "") or "").name

    @property
    def neutral(self) -> Float[np.ndarray, " symbols"]:
        """Values at which it changes nothing."""
        return np.array([symbol.neutral for symbol in self.symbols])

    @property
    def amplitudes(self) -> Bool[np.ndarray, " symbols"]:
        """Which of its symbols are its size; the others are its shape."""
        return (self.neutral == 0.0) | (len(self.symbols) == 1)

    def part(self, values: Sequence[float], share: float) -> tuple[float, ...]:
        """Values at a share of the way from those that change nothing.

        The share is from 0 to 1; what changes nothing at infinity is as far off as 1 / share says.
        """
        return tuple(
            s.neutral + share * (value - s.neutral)
            if math.isfinite(s.neutral)
            else (value / share if share > 0.0 else s.neutral)
            for s, value in zip(self.symbols, values, strict=True)
        )

    def units(self, layout: Layout, target: str) -> tuple[str, ...]:
        """Units of its symbols at a target."""
        position, force = layout.unit_of(target)
        return tuple(symbol.unit.format(q=position, f=force) for symbol in self.symbols)


def sizes(*values: float) -> Probe:
    """One size of an effect."""
    return Probe(np.array([values]))


def not_proportional(*values: float, unit: float = 1.0) -> list[Probe]:
    """Sizes of an effect of one symbol, whose signature does not simply grow with it."""
    return [Probe(np.array([[value * unit]]), proportional=False) for value in values]
