"""A plant with some effects as a function of a parameter vector, and what may be simulated of it.

A sticking or stiff motion takes a hundred times the integrator steps of a smooth one, and a search
that no model satisfies tries all that it can. So steps are counted, not fits, and equal data lead
to equal results. Every stage gets a part of the steps that are left.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from mcpilco.gap.thresholds import BUDGET, FIT
from mcpilco.plant import (
    OFFSET,
    SCALE,
    TURN,
    Axis,
    DryFriction,
    EffectInstance,
    Plant,
    Scale,
    Symbol,
    Tables,
)

Theta = Float[np.ndarray, " p"]
"""uncertain parameters, then values of effects, then coordinates of learned forces"""
InitialStates = Float[np.ndarray, "W X"]
"""of W windows, in each state's unit"""
PerWindow = Float[np.ndarray, " W"]
"""a number for each window"""


@dataclass(frozen=True)
class ComputeBudget:
    """The steps that an investigation may take, and those that it has taken."""

    most: float = BUDGET.steps
    """that it may take"""
    used: Int[np.ndarray, " 1"] = field(default_factory=lambda: np.zeros(1, dtype=np.int64))
    """counted by the simulation"""
    finer: float = 1.0
    """times as many as with commands that are held as long as usual [-]"""

    @classmethod
    def at(cls, held_s: float, costly: bool, most: float = BUDGET.steps) -> ComputeBudget:
        """The steps that may be taken with commands that are held for so long [s].

        MuJoCo, where a simulation is costly, takes steps of its own, however long that is.
        """
        finer = 1.0 if costly else max(1.0, BUDGET.usual_dt_s / held_s)
        return cls(most * finer, finer=finer)

    def for_stage(self) -> ComputeBudget:
        """The same, with the steps left at least that a stage must have."""
        return replace(self, most=max(self.most, self.used[0] + BUDGET.stage_steps * self.finer))

    def share(self, part: float) -> ComputeBudget:
        """A part of the steps that are left, for a stage that begins now."""
        return replace(self, most=self.used[0] + part * max(self.most - self.used[0], 0.0))

    @property
    def used_up(self) -> bool:
        """Whether a stage has to end with what it has."""
        return bool(self.used[0] >= self.most)


@dataclass(frozen=True)
class GridForce:
    """A force in a joint whose R coordinates are standard normal before data are seen."""

    joint: str
    """in which it acts"""
    axes: tuple[Axis, ...]
    """of its grid"""
    basis: Float[np.ndarray, "M R"]
    """weights of the splines for one unit of each coordinate [N or N m]"""

    @property
    def grid(self) -> tuple[str, tuple[Axis, ...]]:
        """Joint and axes."""
        return self.joint, self.axes


@dataclass(frozen=True)
class PlantModel:
    """A plant, effects that are added to it, and its uncertain parameters.

    Its vector theta holds the uncertain nominal parameters, each relative to its nominal value, and
    then the values of the effects. Symbols that are positive and far from 0 enter as logarithms.
    """

    plant: Plant
    added: tuple[EffectInstance, ...]
    """effects that are added"""
    priors: Mapping[str, float]
    """uncertain parameters of the plant, with the relative prior std of each; inf frees one"""
    scales: Mapping[str, Scale]
    """by target"""
    freed: tuple[EffectInstance, ...] = ()
    """effects that come down to an uncertain parameter, whose prior is lifted instead"""
    learned: tuple[GridForce, ...] = ()
    """forces that no effect explains; their coordinates stand last in theta"""
    budget: ComputeBudget = field(default_factory=ComputeBudget)
    """of the investigation that simulates it"""
    finer: int = 1
    """times as short a timestep: a touch that comes at another time has another derivative too"""
    _tables: dict[bytes, Tables] = field(default_factory=dict, init=False, repr=False)
    """those of the last single system"""

    @property
    def effects(self) -> tuple[EffectInstance, ...]:
        """All its effects."""
        return self.freed + self.added

    def frees(self, instance: EffectInstance) -> int | None:
        """Which uncertain parameter an effect comes down to, of those that a prior holds."""
        name, effect = self.plant.parameter_of(instance), instance.effect
        if name is None or not np.isfinite(self.priors.get(name, np.inf)):
            return None
        slight = FIT.nothing * effect.probes(self.scales[instance.target])[0].values[0, 0]
        sums = effect.neutral[0] == 0.0  # not so a gain
        return None if sums and self.plant.values[name] < slight else [*self.priors].index(name)

    def _parameter(self, instance: EffectInstance) -> str:
        """The parameter that one of the freed effects comes down to."""
        name = self.plant.parameter_of(instance)
        assert name is not None
        return name

    def having(self, instance: EffectInstance) -> PlantModel:
        """This model with one effect more."""
        if self.frees(instance) is None:
            return replace(self, added=(*self.added, instance))
        freed = {self._parameter(instance): np.inf}
        return replace(self, priors={**self.priors, **freed}, freed=(*self.freed, instance))

    def grown(
        self,
        theta: Theta,
        instance: EffectInstance,
        values: Sequence[float] | Float[np.ndarray, " n"],
    ) -> tuple[PlantModel, Float[np.ndarray, " more"]]:
        """The model with one effect more, and theta with its values."""
        model = self.having(instance)
        return model, model.appended(theta, values)

    def appended(
        self,
        theta: Float[np.ndarray, " n"],
        values: Sequence[float] | Float[np.ndarray, " symbols"],
    ) -> Float[np.ndarray, " more"]:
        """Theta that lacks the last effect, with values of it; as it is where it lacks none."""
        logs = self.logarithmic[len(theta) :]
        if not len(logs):
            return theta
        added = np.asarray(values, dtype=float)
        added = np.where(logs, np.log(np.where(logs, added, 1.0)), added)
        return self.softened(np.clip(np.concatenate([theta, added]), *self.bounds))

    def shrunk(
        self, theta: Theta, instance: EffectInstance, prior: float
    ) -> tuple[PlantModel, Float[np.ndarray, " n"]]:
        """The model without one of its effects, and theta; `prior` is that of a parameter."""
        if instance in self.freed:
            held = {self._parameter(instance): prior}
            rest = tuple(other for other in self.freed if other != instance)
            return replace(self, priors={**self.priors, **held}, freed=rest), theta
        span = self.spans()[self.added.index(instance)]
        rest = tuple(other for other in self.added if other != instance)
        return replace(self, added=rest), np.delete(theta, np.arange(span.start, span.stop))

    def scaled(self, theta: Theta, instance: EffectInstance, factor: float) -> Theta:
        """Theta with one of its effects some times as far from what changes nothing."""
        theta = theta.copy()
        if instance in self.freed:
            theta[[*self.priors].index(self._parameter(instance))] *= factor
        else:
            span, effect = self.spans()[self.added.index(instance)], instance.effect
            logs, values = self.logarithmic[span], self.decode(theta[None])[1]
            now, neutral = values[self.added.index(instance)][0], effect.neutral
            sized = effect.amplitudes & np.isfinite(neutral)
            with np.errstate(invalid="ignore"):  # of a limit that is nowhere
                there = np.where(sized, neutral + factor * (now - neutral), now)
            theta[span] = np.where(logs, np.log(np.where(logs, there, 1.0)), there)
        return self.softened(np.clip(theta, *self.bounds))

    def effect_values(
        self, theta: Float[np.ndarray, "S p"]
    ) -> list[tuple[EffectInstance, Float[np.ndarray, "S symbols"]]]:
        """Values of all its effects, of S vectors."""
        parameters, values = self.decode(theta)
        names = [parameter.name for parameter in self.plant.parameters]
        told = []
        for instance in self.freed:
            column = names.index(self._parameter(instance))
            nominal = self.plant.nominal[column]
            value = parameters[:, column : column + 1]
            relative = instance.effect.neutral[0] == 1.0  # as of a gain
            told.append((instance, value / nominal if relative else value - nominal))
        for instance, value in zip(self.added, values, strict=True):
            low, high = zip(*((s.low, s.high) for s in instance.effect.symbols), strict=True)
            told.append((instance, np.clip(value, low, high)))  # exp(log(high)) is not quite high
        return told

    @property
    def nuisances(self) -> int:
        """How many uncertain parameters stand first in theta."""
        return len(self.priors)

    def spans(self) -> list[slice]:
        """Where in theta the values of each effect are."""
        spans, first = [], self.nuisances
        for instance in self.added:
            spans.append(slice(first, first + len(instance.effect.symbols)))
            first = spans[-1].stop
        return spans

    @cached_property
    def coordinates(self) -> int:
        """How many coordinates of learned forces stand last in theta."""
        return sum(force.basis.shape[1] for force in self.learned)

    @cached_property
    def logarithmic(self) -> np.ndarray:
        """Which entries of theta are logarithms."""
        symbols = [s for instance in self.added for s in instance.effect.symbols]
        known = [False] * self.nuisances + [_positive(s) for s in symbols]
        return np.array(known + [False] * self.coordinates, dtype=bool)

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest theta that make physical sense."""
        plausible = [
            (s, *s.bounds(self.scales[instance.target]))
            for instance in self.added
            for s in instance.effect.symbols
        ]
        ranges = [
            (math.log(low), math.log(high)) if _positive(s) else (low, high)
            for s, low, high in plausible
        ]
        low = [-0.95] * self.nuisances + [least for least, _ in ranges]
        high = [np.inf] * self.nuisances + [most for _, most in ranges]
        free = np.full(self.coordinates, np.inf)
        return np.append(low, -free), np.append(high, free)

    def reach(
        self, theta: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Least and largest theta to which one step of a fit may lead.

        Where a model misses much, its linear form asks for masses of next to nothing, or for
        hundreds of times what is there.
        """
        low, high = (bound.copy() for bound in self.bounds)
        low[self.logarithmic] = np.maximum(low, theta - math.log(FIT.farthest))[self.logarithmic]
        high[self.logarithmic] = np.minimum(high, theta + math.log(FIT.farthest))[self.logarithmic]
        ours = slice(self.nuisances)
        low[ours] = np.maximum(low[ours], (1.0 + theta[ours]) / FIT.farthest - 1.0)
        high[ours] = np.minimum(high[ours], FIT.farthest * (1.0 + theta[ours]) - 1.0)
        return low, high

    def softened(self, theta: Theta, unstuck: bool = False) -> Theta:
        """Theta, its dry frictions turning over slowly enough for a simulation to be fast.

        A friction f that turns over within v_r brings a joint of inertia I to rest in I v_r / f,
        which steps must follow as long as it sticks. `unstuck`, within the joint's usual speed.
        """
        theta = theta.copy()
        lightest = 1.0 + min(0.0, theta[: self.nuisances].min(initial=0.0))
        for instance, span in zip(self.added, self.spans(), strict=True):
            friction = instance.effect
            if not isinstance(friction, DryFriction):
                continue
            scale, f = self.scales[instance.target], theta[span][list(friction.forces)].sum()
            f = 0.5 * f if "constant_force" in friction.repeats else f  # there is one each way
            braked = float(f) / (lightest * scale.inertia)
            unseen = min(braked * FIT.quick_s, FIT.unseen_turn * scale.velocity)
            slowest = min(max(braked * FIT.quickest_s, unseen, TURN.low), TURN.high)
            at = span.start + friction.turn
            theta[at] = max(theta[at], math.log(scale.velocity if unstuck else slowest))
        return theta

    def plausible(self, theta: Float[np.ndarray, " n"]) -> bool:
        """Whether no effect is larger than is plausible, nor quicker than a timestep.

        A reading that is late by a part of a timestep is what another integrator does.
        """
        values = self.decode(theta[None])[1]
        each = zip(values, self._least, self._largest, strict=True)
        return all(bool(np.all((low <= v[0]) & (v[0] <= high))) for v, low, high in each)

    @cached_property
    def _least(self) -> list[Float[np.ndarray, " symbols"]]:
        """Values of each effect below which no timestep can tell it."""
        h = self.plant.finely(self.finer).least_s
        seconds = [[symbol.unit == "s" for symbol in each.effect.symbols] for each in self.added]
        return [np.where(some, h or -np.inf, -np.inf) for some in seconds]

    @cached_property
    def _largest(self) -> list[Float[np.ndarray, " symbols"]]:
        """Values of each effect beyond which it is larger than is plausible."""
        return [each.effect.largest(self.scales[each.target]) for each in self.added]

    @cached_property
    def precision(self) -> np.ndarray:
        """Prior precision of theta; 0 where nothing is known."""
        precision = np.zeros(len(self.logarithmic))
        least = dict.fromkeys(self.priors, FIT.free_std)
        forces = [self._parameter(each) for each in self.freed if each.effect.place == "joint"]
        least |= dict.fromkeys(forces, FIT.free_force_std)
        precision[: self.nuisances] = [min(s, least[n]) ** -2 for n, s in self.priors.items()]
        precision[len(precision) - self.coordinates :] = 1.0
        return precision

    def penalty(self, theta: Theta) -> float:
        """-2 log of the prior density at theta, without a constant."""
        return float((self.precision * theta**2).sum())

    def nominal(self, theta: Theta) -> Theta:
        """Theta with the nominal parameters; what is free has none."""
        return np.where(self.held, 0.0, theta)

    @property
    def held(self) -> Bool[np.ndarray, " n"]:
        """Which entries of theta a prior holds near 0."""
        held = np.zeros(len(self.logarithmic), dtype=bool)
        held[: self.nuisances] = np.isfinite([*self.priors.values()])
        return held

    def decode(
        self, theta: Float[np.ndarray, "S n"]
    ) -> tuple[Float[np.ndarray, "S P"], list[Float[np.ndarray, "S symbols"]]]:
        """Parameters of the plant, and values of each effect."""
        plain = np.where(self.logarithmic, np.exp(np.where(self.logarithmic, theta, 0.0)), theta)
        names = [parameter.name for parameter in self.plant.parameters]
        parameters = np.tile(self.plant.nominal, (len(theta), 1))
        for column, name in enumerate(self.priors):
            parameters[:, names.index(name)] *= 1.0 + theta[:, column]
        return parameters, [plain[:, span] for span in self.spans()]

    def tables(self, theta: Float[np.ndarray, "S n"]) -> Tables:
        """S systems, for a simulation; of one that is asked for again and again, the same ones."""
        if len(theta) == 1 and theta.tobytes() in self._tables:
            return self._tables[theta.tobytes()]
        parameters, values = self.decode(theta)
        grids = [force.grid for force in self.learned]
        tables = self.plant.tables(parameters, self.added, values, grids, self.weights(theta))
        if len(theta) == 1:
            self._tables.clear()
            self._tables[theta.tobytes()] = tables
        return tables

    def invert_sensors(
        self, theta: Float[np.ndarray, " n"], measured: Float[np.ndarray, "W X"]
    ) -> Float[np.ndarray, "W X"]:
        """The states that the sensors would measure so at rest."""
        sensors = self.tables(theta[None]).sensors[0]
        return (measured - sensors[:, OFFSET]) / np.maximum(sensors[:, SCALE], FIT.least_scale)

    def weights(self, theta: Float[np.ndarray, "S n"]) -> list[Float[np.ndarray, "S _"]]:
        """Weights of the splines of each learned force."""
        ends = np.cumsum([force.basis.shape[1] for force in self.learned])
        parts = np.split(theta[:, theta.shape[1] - self.coordinates :], ends[:-1], axis=1)
        return [part @ force.basis.T for part, force in zip(parts, self.learned, strict=False)]

    def steps(self, theta: Float[np.ndarray, " n"]) -> Float[np.ndarray, " k"]:
        """Steps for finite differences: far above rounding, and too small to bend.

        The coordinates of learned forces, which stand last in theta, have none.
        """
        sizes = self._usual_steps.copy()
        logs = self.logarithmic[: len(sizes)]
        plain = ~logs & (np.arange(len(sizes)) >= self.nuisances)
        usual, now = sizes[plain], np.abs(theta[: len(sizes)][plain])
        sizes[plain] = np.minimum(usual, np.maximum(1e-2 * now, 0.1 * usual))
        sizes[logs] = 0.03
        return sizes

    @cached_property
    def _usual_steps(self) -> Float[np.ndarray, " k"]:
        """Steps for finite differences by the sizes at which effects are usual."""
        steps = [np.full(self.nuisances, 1e-3)]
        for instance in self.added:
            probes = instance.effect.probes(self.scales[instance.target])
            sizes = np.concatenate([probe.values for probe in probes]) - instance.effect.neutral
            sizes[~np.isfinite(sizes)] = 0.0
            usual = 0.1 * np.abs(sizes).max(axis=0)
            usual[usual == 0.0] = 1e-2
            steps.append(usual)
        return np.concatenate(steps)


def _positive(symbol: Symbol) -> bool:
    return symbol.low > 0.0
