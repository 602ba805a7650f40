"""The plants that are possible: a joint distribution of parameters and effects around a plant.

A number of a plant is known by its name: a parameter's, or `effect.target.symbol` of an effect that
was added, as in `coulomb_friction.cart.f_c`. Each *member* of a spread is a set of effects that the
data allow, with a probability, and a normal distribution of its numbers, or of the logarithms of
those that must be positive.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

from mcpilco.plant.effects.base import Effect, Symbol
from mcpilco.plant.plant import Base, EffectInstance, Parameter, Plant
from mcpilco.typing import InputError

WIDEST = 1.0
"""largest standard deviation of a logarithm [-]: beyond, data say nothing of a number's size"""


@dataclass(frozen=True)
class Member:
    """A set of effects that the data allow, with the distribution of its numbers."""

    probability: float
    """relative to the other members' [-]"""
    values: Mapping[str, float]
    """expected, by name, in each number's unit; effects that only other members name it lacks"""
    std: Mapping[str, float]
    """standard deviations of what is not known exactly, by name, in each number's unit"""
    correlation: tuple[tuple[float, ...], ...]
    """of these, in their order [-]"""

    @cached_property
    def root(self) -> Float[np.ndarray, "Q Q"]:
        """A square root of the correlation matrix."""
        scale, axes = np.linalg.eigh(
            np.array(self.correlation).reshape(len(self.std), len(self.std))
        )
        return axes * np.sqrt(np.maximum(scale, 0.0))

    def within(self, kept: Sequence[str]) -> Member:
        """The marginal distribution of some numbers; it has no others."""
        chosen = [i for i, name in enumerate(self.std) if name in kept]
        return Member(
            self.probability,
            {name: value for name, value in self.values.items() if name in kept},
            {name: std for name, std in self.std.items() if name in kept},
            tuple(tuple(self.correlation[i][j] for j in chosen) for i in chosen),
        )


def name_of(instance: EffectInstance, symbol: Symbol) -> str:
    """The name of a number of an effect."""
    return f"{instance.effect.name}.{instance.target}.{symbol.name}"


def effect_in(name: str) -> tuple[str, str] | None:
    """Effect and target in the name of a number; None of a parameter's."""
    first, _, rest = name.partition(".")
    target, _, symbol = rest.rpartition(".")
    return (first, target) if target and symbol else None


def instances_of(names: Iterable[str], catalogue: Mapping[str, Effect]) -> list[EffectInstance]:
    """The effects that some names speak of.

    Raises:
        InputError: there is no such effect.
    """
    pairs = dict.fromkeys(pair for name in names if (pair := effect_in(name)))
    if unknown := [effect for effect, _ in pairs if effect not in catalogue]:
        raise InputError(f"a spread names {unknown[0]!r}; there is no effect of that name.")
    return [EffectInstance(catalogue[effect], target) for effect, target in pairs]


def opened(plant: Plant) -> Plant:
    """The plant with the finite numbers of its added effects as parameters, behind its own."""
    parameters, base = list(plant.parameters), list(plant.base)
    for instance, values in plant.added:
        units = instance.effect.units(plant.layout, instance.target)
        known: list[float | str] = list(values)
        for i, symbol in enumerate(instance.effect.symbols):
            if symbol.reported and math.isfinite(values[i]):
                known[i] = name_of(instance, symbol)
                named = Parameter(name_of(instance, symbol), values[i], units[i], False, symbol.low)
                parameters.append(named)
        base.append(Base(instance, tuple(known)))
    return replace(plant, parameters=tuple(parameters), base=tuple(base), added=())


def moved(plant: Plant, values: Mapping[str, float]) -> Plant:
    """The plant with other numbers, of parameters and of added effects, by name."""
    added = tuple(
        (
            instance,
            tuple(
                float(values.get(name_of(instance, symbol), value))
                for symbol, value in zip(instance.effect.symbols, known, strict=True)
            ),
        )
        for instance, known in plant.added
    )
    own = {name: float(values[name]) for name in plant.values if name in values}
    return replace(plant.where(**own), added=added)


@dataclass(frozen=True)
class Spread:
    """A distribution over plants."""

    source: Plant
    """as it is expected to be"""
    members: tuple[Member, ...]
    """at least one"""
    share: float = 1.0
    """of the way to the added effects, see `Plant.weakened`"""

    def __post_init__(self) -> None:
        for name in (n for member in self.members for n in (*member.values, *member.std)):
            if name not in self.names:
                raise InputError(f"A spread names {name!r}; the plant has {', '.join(self.names)}.")

    @cached_property
    def everything(self) -> Plant:
        """The source with the effects that it lacks and some member has, as that expects them."""
        expected = {n: v for member in reversed(self.members) for n, v in member.values.items()}
        there = {instance for instance, _ in self.source.added}
        more = [i for i in instances_of(expected, self.source.catalogue) if i not in there]
        plant = self.source.having([(each, each.effect.neutral.tolist()) for each in more])
        own = opened(self.source).values
        return moved(plant, {n: value for n, value in expected.items() if n not in own})

    @cached_property
    def plant(self) -> Plant:
        """The same on the way, its effects' numbers as parameters: what `rows` are of."""
        return opened(self.everything.weakened(self.share))

    @cached_property
    def names(self) -> list[str]:
        """Of the numbers that a draw has."""
        return list(opened(self.everything).values)

    @property
    def dimensions(self) -> int:
        """How many standard normal numbers a draw takes: one chooses its member."""
        return 1 + max(len(member.std) for member in self.members)

    @cached_property
    def _symbols(self) -> dict[str, Symbol]:
        """The symbols of the effects, by the names of their numbers."""
        pairs = [(i, symbol) for i, _ in self.everything.added for symbol in i.effect.symbols]
        return {name_of(instance, symbol): symbol for instance, symbol in pairs}

    def _means(self, values: Mapping[str, float] | None = None) -> Float[np.ndarray, " P"]:
        """The numbers of a member that expects these values; None: of the source."""
        named = {n for member in self.members for n in member.values if n in self._symbols}
        neutral = {name: symbol.neutral for name, symbol in self._symbols.items()}
        own = opened(self.source).values
        if values:
            own = {name: value for name, value in own.items() if name not in named} | {**values}
        return np.array([own.get(name, neutral.get(name)) for name in self.names], dtype=float)

    @property
    def centre(self) -> Float[np.ndarray, " P"]:
        """The numbers of the source."""
        return self._on_the_way(self._means()[None])[0]

    def rows(self, points: Float[np.ndarray, "S D"]) -> Float[np.ndarray, "S P"]:
        """The numbers of S plants, from standard normal ones."""
        ends = np.cumsum([member.probability for member in self.members])
        which = np.searchsorted(ends / ends[-1], ndtr(points[:, 0]))
        means = np.stack([self._means(member.values) for member in self.members])
        rows, away = means[which], np.zeros((len(points), len(self.names)))
        for m, member in enumerate(self.members):
            columns = [self.names.index(name) for name in member.std]
            normal = points[which == m, 1 : 1 + len(columns)] @ member.root.T
            away[np.ix_(which == m, columns)] = normal * list(member.std.values())
        ranges = [
            self._symbols.get(p.name, Symbol("", "", low=p.low)) for p in self.plant.parameters
        ]
        low, high = (np.array([getattr(s, end) for s in ranges]) for end in ("low", "high"))
        logs = (low > 0.0) & (rows > 0.0)
        relative = np.clip(away / np.where(logs, rows, 1.0), -3.0 * WIDEST, 3.0 * WIDEST)
        drawn = np.where(logs, rows * np.exp(relative), rows + away)
        return self._on_the_way(np.clip(drawn, low, high))

    def _on_the_way(self, rows: Float[np.ndarray, "S P"]) -> Float[np.ndarray, "S P"]:
        """The rows with their effects at the share of the way from those that change nothing."""
        for instance, _ in self.everything.added:
            names = [name_of(instance, symbol) for symbol in instance.effect.symbols]
            at = [self.names.index(name) if name in self.names else None for name in names]
            parts: list[Any] = [0.0 if i is None else rows[:, i] for i in at]
            for i, part in zip(at, instance.effect.part(parts, self.share), strict=True):
                if i is not None:
                    rows[:, i] = part
        return rows

    def weakened(self, share: float) -> Spread:
        """The same plants with their effects on the way, see `Plant.weakened`."""
        return replace(self, share=share)

    def plants(self, points: Float[np.ndarray, "S D"]) -> Iterator[Plant]:
        """S plants that are drawn, each with its numbers."""
        for row in self.rows(points):
            yield moved(self.everything, dict(zip(self.names, row, strict=True)))


def expressible(members: Sequence[Member], catalogue: Mapping[str, Effect]) -> tuple[Member, ...]:
    """The members without the effects that a model's equations cannot say."""

    def said(name: str) -> bool:
        return all(i.effect.in_equations() for i in instances_of([name], catalogue))

    return tuple(member.within([n for n in member.values if said(n)]) for member in members)


def members_of(content: Sequence[Any]) -> tuple[Member, ...]:
    """The members in the part `spread` of a correction's file.

    Raises:
        InputError: something else is there.
    """
    return tuple(map(_member, content))


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
            raise InputError(
                f"the spread of {word} must be a relative standard deviation from 0 to "
                f"{WIDEST:g}, got {part!r}."
            )
        fitting = [p for p in known if p.name == word or p.name.endswith((f"_{word}", f".{word}"))]
        fitting = fitting or [p for p in known if word == "all" and p.uncertain]
        if not fitting:
            there = ", ".join(p.name for p in known)
            raise InputError(f"{plant.name} has no {word!r} that is not 0; it has {there}.")
        std |= {p.name: float(part * abs(p.value)) for p in fitting}
    return (Member(1.0, {}, std, tuple(map(tuple, np.eye(len(std)).tolist()))),)


def _member(content: Any) -> Member:
    """A member from its JSON object."""
    keys = ("probability", "values", "std", "correlation")
    try:
        if set(content) != set(keys):
            raise ValueError(f"must have {', '.join(keys)} and no more")
        values, std = (
            {str(name): float(number) for name, number in content[key].items()}
            for key in ("values", "std")
        )
        correlation = tuple(tuple(map(float, row)) for row in content["correlation"])
        numbers = [*values.values(), *std.values(), *(x for row in correlation for x in row)]
        if not (np.isfinite(numbers).all() and min(std.values(), default=0.0) >= 0.0):
            raise ValueError("must have finite numbers, and no std below 0")
        if [len(row) for row in correlation] != [len(std)] * len(std):
            raise ValueError(f"must have a correlation of {len(std)} x {len(std)}, as std has")
        probability = float(content["probability"])
        if not 0.0 < probability <= 1.0:
            raise ValueError(f"must have a probability in (0, 1], got {probability:g}")
    except (AttributeError, TypeError, ValueError) as error:
        raise InputError(f"a member of a spread {error}.") from None
    return Member(probability, values, std, correlation)
