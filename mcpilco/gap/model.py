"""A plant with some effects as a function of a vector of parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from mcpilco.bodies import generalised_forces, mass_matrix
from mcpilco.gap.effort import Effort
from mcpilco.gap.grid_force import GridForce
from mcpilco.gap.windows import Windows
from mcpilco.plant import (
    OFFSET,
    SCALE,
    TURN,
    DryFriction,
    EffectInstance,
    Plant,
    Scale,
    Symbol,
    Tables,
)

FREE = 1.0
"""relative prior std of a parameter of which nothing is known: its order of magnitude is meant"""
FARTHEST = 2.5
"""factor by which a step of a fit may change a mass, or what enters as a logarithm"""
LEAST_SCALE = 0.1
"""of a sensor, below which its measurement is not read back"""
QUICKEST_S = 1e-4
"""in which dry friction may bring its joint to rest [s]"""


@dataclass(frozen=True)
class Model:
    """A plant, effects that are added to it, and what is not known exactly.

    Its vector theta holds the uncertain nominal parameters, each relative to its nominal value, and
    then the values of the effects. Symbols that are positive and far from 0 enter as logarithms.
    """

    plant: Plant
    actives: tuple[EffectInstance, ...]
    """effects that are added"""
    priors: Mapping[str, float]
    """uncertain parameters of the plant, with the relative prior std of each; inf frees one"""
    scales: Mapping[str, Scale]
    """by target"""

    freed: tuple[EffectInstance, ...] = ()
    """effects that come down to an uncertain parameter, whose prior is lifted instead"""
    learned: tuple[GridForce, ...] = ()
    """forces that no effect explains; their coordinates stand last in theta"""
    effort: Effort = field(default_factory=Effort)
    """of the investigation that simulates it"""

    @property
    def named(self) -> tuple[EffectInstance, ...]:
        """All its effects."""
        return self.freed + self.actives

    def frees(self, active: EffectInstance) -> int | None:
        """Which uncertain parameter an effect comes down to, of those that a prior holds."""
        name = self.plant.parameter_of(active)
        if name is None or not np.isfinite(self.priors.get(name, np.inf)):
            return None
        return list(self.priors).index(name)

    def _parameter(self, active: EffectInstance) -> str:
        """The parameter that one of the freed effects comes down to."""
        name = self.plant.parameter_of(active)
        assert name is not None
        return name

    def having(self, active: EffectInstance) -> Model:
        """This model with one effect more."""
        if self.frees(active) is None:
            return replace(self, actives=(*self.actives, active))
        freed = {self._parameter(active): np.inf}
        return replace(self, priors={**self.priors, **freed}, freed=(*self.freed, active))

    def grown(
        self,
        theta: Float[np.ndarray, " p"],
        active: EffectInstance,
        values: Sequence[float] | Float[np.ndarray, " n"],
    ) -> tuple[Model, Float[np.ndarray, " n"]]:
        """The model with one effect more, and theta with its values."""
        model = self.having(active)
        if len(model.actives) == len(self.actives):
            return model, theta
        added = np.asarray(values, dtype=float)
        logs = np.array([_positive(symbol) for symbol in active.effect.symbols])
        added = np.where(logs, np.log(np.where(logs, added, 1.0)), added)
        return model, model.softened(np.clip(np.concatenate([theta, added]), *model.bounds))

    def shrunk(
        self, theta: Float[np.ndarray, " p"], active: EffectInstance, prior: float
    ) -> tuple[Model, Float[np.ndarray, " n"]]:
        """The model without one of its effects, and theta; `prior` is that of a parameter."""
        if active in self.freed:
            held = {self._parameter(active): prior}
            rest = tuple(other for other in self.freed if other != active)
            return replace(self, priors={**self.priors, **held}, freed=rest), theta
        span = self.spans()[self.actives.index(active)]
        rest = tuple(other for other in self.actives if other != active)
        return replace(self, actives=rest), np.delete(theta, np.arange(span.start, span.stop))

    def told(
        self, theta: Float[np.ndarray, "S p"]
    ) -> list[tuple[EffectInstance, Float[np.ndarray, "S symbols"]]]:
        """Values of all its effects, of S vectors."""
        parameters, values = self.decode(theta)
        names = [parameter.name for parameter in self.plant.parameters]
        freed = []
        for active in self.freed:
            column = names.index(self._parameter(active))
            nominal = self.plant.nominal[column]
            found = parameters[:, column : column + 1]
            relative = active.effect.neutral[0] == 1.0  # a gain is told relative to the nominal one
            freed.append((active, found / nominal if relative else found - nominal))
        added = [
            (active, _within(active.effect.symbols, found))
            for active, found in zip(self.actives, values, strict=True)
        ]
        return freed + added

    @property
    def nuisances(self) -> int:
        """How many uncertain parameters stand first in theta."""
        return len(self.priors)

    def spans(self) -> list[slice]:
        """Where in theta the values of each effect are."""
        spans, first = [], self.nuisances
        for active in self.actives:
            spans.append(slice(first, first + len(active.effect.symbols)))
            first = spans[-1].stop
        return spans

    @cached_property
    def coordinates(self) -> int:
        """How many coordinates of learned forces stand last in theta."""
        return sum(force.basis.shape[1] for force in self.learned)

    @cached_property
    def logarithmic(self) -> np.ndarray:
        """Which entries of theta are logarithms."""
        symbols = [s for active in self.actives for s in active.effect.symbols]
        known = [False] * self.nuisances + [_positive(s) for s in symbols]
        return np.array(known + [False] * self.coordinates, dtype=bool)

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest theta that make physical sense."""
        symbols = [s for active in self.actives for s in active.effect.symbols]
        low = [-0.95] * self.nuisances
        low += [np.log(s.low) if _positive(s) else s.low for s in symbols]
        high = [np.inf] * self.nuisances
        high += [np.log(s.high) if _positive(s) else s.high for s in symbols]
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
        low[self.logarithmic] = np.maximum(low, theta - math.log(FARTHEST))[self.logarithmic]
        high[self.logarithmic] = np.minimum(high, theta + math.log(FARTHEST))[self.logarithmic]
        ours = slice(self.nuisances)
        low[ours] = np.maximum(low[ours], (1.0 + theta[ours]) / FARTHEST - 1.0)
        high[ours] = np.minimum(high[ours], FARTHEST * (1.0 + theta[ours]) - 1.0)
        return low, high

    def softened(self, theta: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Theta, its dry frictions turning over slowly enough for a simulation to be fast.

        A friction f that turns over within v_r brings a joint of inertia I to rest in I v_r / f,
        which steps must follow as long as it sticks.
        """
        theta = theta.copy()
        lightest = 1.0 + min(0.0, theta[: self.nuisances].min(initial=0.0))
        for active, span in zip(self.actives, self.spans(), strict=True):
            friction = active.effect
            if not isinstance(friction, DryFriction):
                continue
            inertia = lightest * self.scales[active.target].inertia
            slowest = float(theta[span][list(friction.forces)].sum()) * QUICKEST_S / inertia
            at = span.start + friction.turn
            theta[at] = max(theta[at], math.log(min(max(slowest, TURN.low), TURN.high)))
        return theta

    def plausible(self, theta: Float[np.ndarray, " n"]) -> bool:
        """Whether no effect is larger than what could be meant."""
        values = self.decode(theta[None])[1]
        return all(
            bool(np.all(value[0] <= active.effect.largest(self.scales[active.target])))
            for active, value in zip(self.actives, values, strict=True)
        )

    @cached_property
    def precision(self) -> np.ndarray:
        """Prior precision of theta; 0 where nothing is known."""
        precision = np.zeros(len(self.logarithmic))
        precision[: self.nuisances] = [min(std, FREE) ** -2 for std in self.priors.values()]
        precision[len(precision) - self.coordinates :] = 1.0
        return precision

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
        """S systems, for a simulation."""
        parameters, values = self.decode(theta)
        grids = [force.grid for force in self.learned]
        return self.plant.tables(parameters, self.actives, values, grids, self.weights(theta))

    def unread(
        self, theta: Float[np.ndarray, " n"], measured: Float[np.ndarray, "W X"]
    ) -> Float[np.ndarray, "W X"]:
        """States of which the sensors would measure this at rest."""
        sensors = self.tables(theta[None]).sensors[0]
        return (measured - sensors[:, OFFSET]) / np.maximum(sensors[:, SCALE], LEAST_SCALE)

    def weights(self, theta: Float[np.ndarray, "S n"]) -> list[Float[np.ndarray, "S _"]]:
        """Weights of the splines of each learned force."""
        ends = np.cumsum([force.basis.shape[1] for force in self.learned])
        parts = np.split(theta[:, theta.shape[1] - self.coordinates :], ends[:-1], axis=1)
        return [part @ force.basis.T for part, force in zip(parts, self.learned, strict=False)]

    def steps(self, theta: Float[np.ndarray, " n"]) -> Float[np.ndarray, " k"]:
        """Steps for finite differences: felt above rounding, and too small to bend.

        The coordinates of learned forces, which stand last in theta, have none.
        """
        steps = [np.full(self.nuisances, 1e-3)]
        for active in self.actives:
            probes = active.effect.probes(self.scales[active.target])
            sizes = np.concatenate([probe.values for probe in probes]) - active.effect.neutral
            sizes[~np.isfinite(sizes)] = 0.0
            usual = 0.1 * np.abs(sizes).max(axis=0)
            usual[usual == 0.0] = 1e-2
            steps.append(usual)
        found = np.concatenate(steps)
        theta, ours = theta[: len(found)], self.logarithmic[: len(found)]
        found[ours] = 0.03
        found[self.nuisances :] = np.where(
            ours[self.nuisances :],
            found[self.nuisances :],
            np.minimum(
                found[self.nuisances :],
                np.maximum(1e-2 * np.abs(theta[self.nuisances :]), 0.1 * found[self.nuisances :]),
            ),
        )
        return found


def _positive(symbol: Symbol) -> bool:
    return symbol.low > 0.0


def _within(
    symbols: Sequence[Symbol], values: Float[np.ndarray, "S n"]
) -> Float[np.ndarray, "S n"]:
    """The values; at a bound, the exponential of its logarithm may lie beyond it by rounding."""
    return np.clip(values, [s.low for s in symbols], [s.high for s in symbols])


def scales(plant: Plant, windows: Windows) -> dict[str, Scale]:
    """What is usual at each target of a plant in some recordings."""
    layout = plant.layout
    chain = plant.chain
    J = len(layout.joints)
    found = {}
    y = windows.y.copy()
    for j in range(J):  # velocities that were not measured
        v = np.gradient(y[:, 2 * j], windows.dt, axis=-1)
        y[:, 2 * j + 1] = np.where(np.isfinite(y[:, 2 * j + 1]), y[:, 2 * j + 1], v)
    q, v = (y[:, part::2].transpose(0, 2, 1).reshape(-1, J) for part in (0, 1))
    fine = np.isfinite(q).all(axis=1) & np.isfinite(v).all(axis=1)
    q, v = q[fine], v[fine]
    inertias = mass_matrix(chain, q[:200]).mean(axis=0)
    weights = generalised_forces(chain, q, np.zeros_like(q), np.zeros_like(q))
    commands = np.abs(windows.commands).reshape(-1, windows.commands.shape[-1])
    targets = {*layout.joints, *layout.bodies, *layout.actuators, *layout.states}
    for target in targets:
        j = layout.joint_of(target)
        body = chain.bodies[j]
        inputs = [u for u, joint in enumerate(layout.drives) if joint == j] or [0]
        u = layout.actuators.index(target) if target in layout.actuators else inputs[0]
        gain = commands[:, u].std() + commands[:, u].mean()
        driven = gain if j in layout.drives else 0.0
        velocity = np.sqrt(np.mean(v[:, j] ** 2))
        signal = y[:, layout.states.index(target)] if target in layout.states else q[:, j]
        inertia = float(inertias[j, j])
        force = max(driven, np.sqrt(np.mean(weights[:, j] ** 2)), 0.1 * inertia * velocity / 0.1)
        found[target] = Scale(
            position=float(np.abs(q[:, j]).max()) + 1e-9,
            velocity=float(velocity) + 1e-9,
            force=float(force) + 1e-12,
            command=float(commands[:, u].max()) + 1e-12,
            signal=float(np.sqrt(np.nanmean(signal**2))) + 1e-9,
            inertia=inertia,
            mass=body.mass,
            length=float(np.linalg.norm(body.center)),
            dt=windows.dt,
        )
    return found
