"""The plants that are possible: a joint distribution of parameters and effects around a plant.

A number of a plant is known by its name: a parameter's, or `effect.target.symbol` of an effect that
was added, as in `coulomb_friction.cart.f_c`. Each *member* of a spread is a set of effects that the
data allow, with a probability, and a normal distribution of its numbers, or of the logarithms of
those that must be positive.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

from mcpilco.plant.effects import CATALOGUE, Effect, Symbol
from mcpilco.plant.plant import Base, EffectInstance, Parameter, Plant
from mcpilco.typing import InputError

P = TypeVar("P", bound=Plant)
WIDEST = 1.0
"""largest relative standard deviation [-]: beyond, nothing is known of a number's size"""


@dataclass(frozen=True)
class Member:
    """A set of effects that the data allow, with the distribution of its numbers.

    Raises:
        InputError: a number is not finite, a standard deviation negative, or the correlation not of
            as many numbers as these.
    """

    probability: float
    """relative to the other members' [-]"""
    values: Mapping[str, float]
    """expected, by name, in each number's unit; effects that only other members name it lacks"""
    std: Mapping[str, float]
    """standard deviations of what is not known exactly, by name, in each number's unit"""
    correlation: tuple[tuple[float, ...], ...]
    """of these, in their order [-]"""

    def __post_init__(self) -> None:
        count, std = len(self.std), [*self.std.values()]
        numbers = [*self.values.values(), *std, *(x for row in self.correlation for x in row)]
        if not (np.isfinite(numbers).all() and min(std, default=0.0) >= 0.0):
            raise InputError("a member of a spread must have finite numbers, and no std below 0.")
        if [len(row) for row in self.correlation] != [count] * count:
            raise InputError(f"a member of a spread must have a correlation of {count} x {count}.")
        if not 0.0 < self.probability <= 1.0:
            raise InputError(f"a member's probability must be in (0, 1], got {self.probability:g}.")

    def draw(self, points: Float[np.ndarray, "S D"]) -> Float[np.ndarray, "S Q"]:
        """Errors of its numbers, in their units, from standard normal ones."""
        count = len(self.std)
        scale, axes = np.linalg.eigh(np.array(self.correlation).reshape(count, count))
        root = axes * np.sqrt(np.maximum(scale, 0.0))
        return points[:, :count] @ root.T * list(self.std.values())

    def within(self, kept: Sequence[str]) -> Member:
        """The marginal distribution of some numbers; it has no others."""
        chosen = [i for i, name in enumerate(self.std) if name in kept]
        values, std = ({n: x for n, x in d.items() if n in kept} for d in (self.values, self.std))
        rows = tuple(tuple(self.correlation[i][j] for j in chosen) for i in chosen)
        return Member(self.probability, values, std, rows)


def name_of(instance: EffectInstance, symbol: Symbol) -> str:
    """The name of a number of an effect."""
    return f"{instance.effect.name}.{instance.target}.{symbol.name}"


def instance_in(name: str, catalogue: Mapping[str, Effect] = CATALOGUE) -> EffectInstance | None:
    """The effect in the name of a number; None of a parameter's."""
    first, _, rest = name.partition(".")
    target, _, symbol = rest.rpartition(".")
    known = target and symbol and first in catalogue
    return EffectInstance(catalogue[first], target) if known else None


def opened(plant: P) -> P:
    """The plant with the finite numbers of its added effects as parameters, behind its own."""
    parameters, base = list(plant.parameters), list(plant.base)
    for instance, values in plant.added:
        units = instance.effect.units(plant.layout, instance.target)
        known: list[float | str] = list(values)
        for i, symbol in enumerate(instance.effect.symbols):
            if symbol.reported and math.isfinite(values[i]):
                known[i] = name = name_of(instance, symbol)
                parameters.append(
                    Parameter(name, values[i], units[i], False, symbol.low, symbol.high)
                )
        base.append(Base(instance, tuple(known)))
    return replace(plant, parameters=tuple(parameters), base=tuple(base), added=())


def moved(plant: Plant, values: Mapping[str, float]) -> Plant:
    """The plant with other numbers, of parameters and of added effects, by name."""

    def numbers(instance: EffectInstance, known: Sequence[float]) -> tuple[float, ...]:
        pairs = zip(instance.effect.symbols, known, strict=True)
        return tuple(float(values.get(name_of(instance, symbol), x)) for symbol, x in pairs)

    added = tuple((instance, numbers(instance, known)) for instance, known in plant.added)
    own = {name: float(values[name]) for name in plant.values if name in values}
    return replace(plant.where(**own), added=added)


def doubted(plant: Plant, member: Member) -> tuple[Plant, Float[np.ndarray, "K K"]]:
    """The plant in which only those parameters are uncertain that a member doubts.

    With the covariance of their logarithms [-]. Numbers of effects stay as they are.
    """
    own = [name for name, value in plant.values.items() if member.std.get(name) and value != 0.0]
    flagged = (replace(p, uncertain=p.name in own) for p in plant.parameters)
    known = member.within(own)
    std = np.array([known.std[name] / abs(plant.values[name]) for name in known.std])
    order = [list(known.std).index(name) for name in own]
    correlation = np.array(known.correlation).reshape(len(own), len(own))
    covariance = (correlation * np.outer(std, std))[np.ix_(order, order)]
    return replace(plant, parameters=tuple(flagged)), covariance


@dataclass(frozen=True)
class Spread:
    """A distribution over plants.

    Raises:
        InputError: a member names what there is not.
    """

    source: Plant
    """as it is expected to be"""
    members: tuple[Member, ...]
    """at least one"""

    def __post_init__(self) -> None:
        for name in (n for member in self.members for n in (*member.values, *member.std)):
            if name not in self.names:
                raise InputError(f"A spread names {name!r}; the plant has {', '.join(self.names)}.")

    @cached_property
    def everything(self) -> Plant:
        """The source with the effects that it lacks and some member has, as that expects them."""
        expected = {n: v for member in reversed(self.members) for n, v in member.values.items()}
        there, own = {instance for instance, _ in self.source.added}, opened(self.source).values
        named = dict.fromkeys(instance_in(name, self.source.catalogue) for name in expected)
        more = [each for each in named if each and each not in there]
        plant = self.source.having([(each, each.effect.neutral.tolist()) for each in more])
        return moved(plant, {n: v for n, v in expected.items() if n not in own})

    @cached_property
    def plant(self) -> Plant:
        """The same, its effects' numbers as parameters: what `rows` are of."""
        return opened(self.everything)

    @property
    def names(self) -> list[str]:
        """Of the numbers that a draw has."""
        return list(self.plant.values)

    @property
    def dimensions(self) -> int:
        """How many standard normal numbers a draw takes: one chooses its member."""
        return 1 + max(len(member.std) for member in self.members)

    def expected(self, values: Mapping[str, float]) -> Float[np.ndarray, " P"]:
        """The numbers of a member that expects these values; without any, of the source."""
        added = [i for i, _ in self.everything.added]
        absent = {name_of(i, symbol): symbol.neutral for i in added for symbol in i.effect.symbols}
        known = absent | opened(self.source).values
        if values:  # effects that other members name it lacks
            named = {n for member in self.members for n in member.values if n in absent}
            known |= {name: absent[name] for name in named} | dict(values)
        return np.array([known[name] for name in self.names])

    def rows(self, points: Float[np.ndarray, "S D"]) -> Float[np.ndarray, "S P"]:
        """The numbers of S plants, from standard normal ones."""
        ends = np.cumsum([member.probability for member in self.members])
        which = np.searchsorted(ends / ends[-1], ndtr(points[:, 0]))
        rows = np.stack([self.expected(member.values) for member in self.members])[which]
        away = np.zeros_like(rows)
        for m, member in enumerate(self.members):
            columns = [self.names.index(name) for name in member.std]
            away[np.ix_(which == m, columns)] = member.draw(points[which == m, 1:])
        low, high = np.array([(p.low, p.high) for p in self.plant.parameters]).T
        logs = (low > 0.0) & (rows > 0.0)
        relative = np.clip(away / np.where(logs, rows, 1.0), -3.0 * WIDEST, 3.0 * WIDEST)
        return np.clip(np.where(logs, rows * np.exp(relative), rows + away), low, high)

    def plants(self, points: Float[np.ndarray, "S D"]) -> Iterator[Plant]:
        """S plants that are drawn, each with its numbers."""
        for row in self.rows(points):
            yield moved(self.everything, dict(zip(self.names, row, strict=True)))


def members_of(content: Sequence[Any]) -> tuple[Member, ...]:
    """The members in the part `spread` of a correction's file.

    Raises:
        InputError: something else is there.
    """
    try:
        return tuple(map(_member, content))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            "a member of a spread must have probability, values, std and correlation, as "
            f"`mcpilco gap` writes them: {error}."
        ) from None


def _member(entry: Any) -> Member:
    values, std = ({str(n): float(x) for n, x in entry[k].items()} for k in ("values", "std"))
    rows = tuple(tuple(map(float, row)) for row in entry["correlation"])
    return Member(float(entry["probability"]), values, std, rows)


def recipe_of(plant: Plant, relative: Mapping[str, float]) -> tuple[Member, ...]:
    """A spread of independent numbers, by relative standard deviations.

    Each is for the number of that name, for all whose last word it is, as in {"mass": 0.1,
    "f_c": 0.3}, or for `all` parameters that are not exactly known.

    Raises:
        InputError: the plant has no such number, or a standard deviation that is none.
    """
    known = [p for p in opened(plant).parameters if p.value != 0.0]
    std: dict[str, float] = {}
    for word, part in relative.items():
        if not (isinstance(part, int | float) and 0.0 <= part <= WIDEST):
            raise InputError(f"the spread of {word} must be from 0 to {WIDEST:g}, got {part!r}.")
        fitting = [p for p in known if p.name == word or p.name.endswith((f"_{word}", f".{word}"))]
        fitting = fitting or [p for p in known if word == "all" and p.uncertain]
        if not fitting:
            there = ", ".join(p.name for p in known)
            raise InputError(f"{plant.name} has no {word!r} that is not 0; it has {there}.")
        std |= {p.name: float(part * abs(p.value)) for p in fitting}
    return (Member(1.0, {}, std, tuple(map(tuple, np.eye(len(std)).tolist()))),)
