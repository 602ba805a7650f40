"""A plant: what an env simulates, and what recordings are compared with."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any, Self

import numpy as np
from jaxtyping import Float, Int

from mcpilco.bodies import Chain, distinct_rows, generalised_forces, mass_matrix, stack
from mcpilco.plant.effects import CATALOGUE, Effect
from mcpilco.plant.effects.actuator import serving
from mcpilco.plant.effects.joint import JointForce
from mcpilco.plant.effects.learned import Axis, LearnedForce, tabulate
from mcpilco.plant.simulation.laws import code_of
from mcpilco.plant.simulation.layout import (
    CONSTANTS,
    GAIN,
    IDEAL_ACTUATOR,
    IDEAL_SENSOR,
    Layout,
    Tables,
)
from mcpilco.plant.simulation.motion import simulate
from mcpilco.plant.simulation.stepper import Stepper
from mcpilco.typing import InputError

MANY = 4
"""joints beyond which equations cost as much as a simulation by MuJoCo"""
SERVED = serving(np.vectorize)
"""the force of a servo, of arrays"""


@dataclass(frozen=True)
class Parameter:
    """A physical parameter of a plant."""

    name: str
    """as `--set name=value` takes it"""
    value: float
    """nominal, in its unit"""
    unit: str
    """for example kg"""
    uncertain: bool = True
    """whether a nominal value is never exact: masses, lengths, friction, gains; not gravity"""
    low: float = 0.0
    """least value that makes sense"""
    high: float = np.inf
    """largest one"""


@dataclass(frozen=True)
class EffectInstance:
    """An effect at its target."""

    effect: Effect
    target: str
    """a joint, body, actuator or state, as the effect's place has it"""

    def __str__(self) -> str:
        return f"{self.effect.name} ({self.target})"

    def holds(self, other: EffectInstance) -> bool:
        """Whether the other is a special case of this; it may act at another place, as a motor."""
        elsewhere = self.effect.place is not other.effect.place
        return other.effect.name in self.effect.special and (
            elsewhere or self.target == other.target
        )

    def values_as(self, special: EffectInstance, values: Sequence[float]) -> list[float]:
        """Values of a special case near those of this: of equal symbols, else by their order."""
        symbols = special.effect.symbols
        near = {symbol.name: value for symbol, value in zip(symbols, values, strict=False)}
        near |= {
            symbol.name: value for symbol, value in zip(self.effect.symbols, values, strict=True)
        }
        return [near.get(symbol.name, symbol.neutral) for symbol in symbols]

    def repeats(self, other: EffectInstance) -> bool:
        """Whether one of the two, beside the other, says a part of the same again."""
        return self.target == other.target and (
            other.effect.name in self.effect.repeats or self.effect.name in other.effect.repeats
        )


@dataclass(frozen=True)
class Base:
    """An effect that belongs to the nominal plant; its values may be named parameters."""

    active: EffectInstance
    values: tuple[float | str, ...]
    """one for each symbol: a number, or the name of a parameter"""


@dataclass(frozen=True)
class Plant(ABC):
    """Bodies on joints, behind actuators and in front of sensors, with what is known of them.

    There are two kinds: equations of an open chain (`ChainPlant`), and MuJoCo itself
    (`mcpilco.mjcf.MujocoPlant`). Who compares, fits or simulates a plant knows this face only.
    """

    name: str
    """as reports call it"""
    layout: Layout
    """names of what moves"""
    parameters: tuple[Parameter, ...]
    """physical parameters"""
    _: KW_ONLY
    base: tuple[Base, ...] = ()
    """effects of the nominal plant"""
    added: tuple[tuple[EffectInstance, tuple[float, ...]], ...] = ()
    """effects that were found, with their values"""
    learned: tuple[LearnedForce, ...] = ()
    """forces that were learned, where no effect explains what is missing"""
    angles: tuple[int, ...] = ()
    """which states are angles [rad]"""
    masses: Mapping[str, str] = field(default_factory=dict)
    """the parameter that is a body's mass, by body"""
    own: tuple[Effect, ...] = ()
    """a user's own effects, beside those of the catalogue"""

    def where(self, **values: float) -> Self:
        """This plant with other values of some parameters.

        Raises:
            InputError: a name that it does not have, or a value that makes no sense.
        """
        for name, value in values.items():
            low = self.parameters[self._column(name)].low
            if not isinstance(value, int | float | np.number):
                raise InputError(f"{name} must be a number of at least {low:g}, got {value!r}.")
            if not (np.isfinite(value) and value >= low):
                raise InputError(f"{name} must be finite and at least {low:g}, got {value:g}.")
        changed = (replace(p, value=values.get(p.name, p.value)) for p in self.parameters)
        return replace(self, parameters=tuple(changed))

    def having(self, effects: Sequence[tuple[EffectInstance, Sequence[float]]]) -> Self:
        """This plant with some effects more, each with a value for each of its symbols.

        Raises:
            InputError: an effect where it cannot act, or another number of values.
        """
        for active, numbers in effects:
            targets, symbols = active.effect.targets(self.layout), active.effect.symbols
            if active.target not in targets:
                raise InputError(
                    f"{active.effect.name} cannot act at {active.target!r} of {self.name}; "
                    f"its targets are {', '.join(targets) or 'none: this kind of plant has none'}."
                )
            if reason := self.refusal(active):
                raise InputError(f"{active} cannot be in {self.name}: {reason}.")
            if len(numbers) != len(symbols):
                raise InputError(
                    f"{active} must have values for {', '.join(s.name for s in symbols)}, "
                    f"got {len(numbers)}."
                )
        more = tuple((active, tuple(map(float, values))) for active, values in effects)
        return replace(self, added=self.added + more)

    def weakened(self, share: float) -> Self:
        """This plant with the effects that were added on their way from nothing to what they are.

        The share is 0 where they change nothing, and 1 for this plant.
        """
        added = tuple((a, a.effect.part(values, share)) for a, values in self.added)
        return replace(self, added=added)

    def knowing(self, effects: Sequence[Effect]) -> Self:
        """This plant with a user's own effects in its catalogue, see `own_effects`."""
        return replace(self, own=(*self.own, *effects))

    @property
    def catalogue(self) -> dict[str, Effect]:
        """The effects that it may lack, by name: the catalogue and a user's own."""
        return CATALOGUE | {effect.name: effect for effect in self.own}

    def with_learned(self, forces: Sequence[LearnedForce]) -> Self:
        """This plant with some learned forces more.

        Raises:
            InputError: a force at a joint, or over a state or input, that it does not have.
        """
        for force in forces:
            force.require(self.layout)
        return replace(self, learned=(*self.learned, *forces))

    @property
    def values(self) -> dict[str, float]:
        """The parameters by name, each in its unit."""
        return {parameter.name: parameter.value for parameter in self.parameters}

    @property
    def nominal(self) -> Float[np.ndarray, " P"]:
        """Values of the parameters, each in its unit."""
        return np.array([parameter.value for parameter in self.parameters])

    def parameter_of(self, active: EffectInstance) -> str | None:
        """The parameter that an effect comes down to: a body's mass, a friction, a gain."""
        if active.effect.name == "body_mass":
            return self.masses.get(active.target)
        named = {base.active: base.values[0] for base in self.base if len(base.values) == 1}
        parameter = named.get(active)
        return parameter if isinstance(parameter, str) else None

    def candidates(self) -> list[EffectInstance]:
        """Every effect of the catalogue at every target that it can have here."""
        return [
            EffectInstance(effect, target)
            for effect in self.catalogue.values()
            for target in effect.targets(self.layout)
            if not self.refusal(EffectInstance(effect, target))
        ]

    def refusal(self, instance: EffectInstance) -> str:
        """Why an effect cannot be at its target; empty where it can."""
        if instance.target in self.layout.servos and instance.effect.name.endswith("dead_zone"):
            return "the command of a servo is a target, and no force"
        return ""

    @abstractmethod
    def tables(
        self,
        parameters: Float[np.ndarray, "S P"],
        actives: Sequence[EffectInstance] = (),
        values: Sequence[Float[np.ndarray, "S _"]] = (),
        grids: Sequence[tuple[str, tuple[Axis, ...]]] = (),
        weights: Sequence[Float[np.ndarray, "S _"]] = (),
    ) -> Tables:
        """S systems, for a simulation.

        Values and weights are those of the further effects and learned forces in each system.
        """

    def _blank(
        self,
        chains: Any,
        forces: Sequence[tuple[JointForce, str]],
        S: int,
        grids: Sequence[tuple[str, tuple[Axis, ...]]],
        weights: Sequence[Float[np.ndarray, "S _"]],
    ) -> Tables:
        """S systems with ideal actuators and sensors, their joint forces to be filled in."""
        layout = self.layout
        return Tables(
            chains=chains,
            law=np.array([code_of(effect) for effect, _ in forces], dtype=np.int64),
            joint=np.array([layout.joints.index(target) for _, target in forces], dtype=np.int64),
            constants=np.zeros((S, len(forces), CONSTANTS)),
            turn=np.zeros((S, len(forces))),
            drives=np.array(layout.drives),
            actuators=np.tile(np.array(IDEAL_ACTUATOR), (S, len(layout.drives), 1)),
            sensors=np.tile(np.array(IDEAL_SENSOR), (S, len(layout.states), 1)),
            learned=tabulate(
                layout,
                [*((force.joint, force.axes) for force in self.learned), *grids],
                [*(np.tile(force.weights, (S, 1)) for force in self.learned), *weights],
                S,
            ),
        )

    @abstractmethod
    def run(
        self,
        tables: Tables,
        system: Int[np.ndarray, " B"],
        start: Float[np.ndarray, "B X"],
        window: Int[np.ndarray, " B"],
        commands: Float[np.ndarray, "W T_all U"],
        lead: int,
        dt: float,
        taken: Int[np.ndarray, " 1"] | None = None,
        every: int = 1,
        path: Float[np.ndarray, "W lead_plus_1 X"] | None = None,
        accuracy: float = 1.0,
    ) -> Float[np.ndarray, "B X T"]:
        """The measured states of B motions, at T samples; NaN from where a motion runs away.

        Arguments are those of `mcpilco.plant.simulate`. MuJoCo keeps its timesteps, whatever
        accuracy is asked for.
        """

    @abstractmethod
    def mass_matrix(self, q: Float[np.ndarray, "N J"]) -> Float[np.ndarray, "N J J"]:
        """The inertia of the joints at some positions [kg, kg m or kg m^2]."""

    @abstractmethod
    def weights(self, q: Float[np.ndarray, "N J"]) -> Float[np.ndarray, "N J"]:
        """The forces that hold it at rest at some positions, springs aside [N or N m]."""

    @abstractmethod
    def mass_and_length(self, target: str) -> tuple[float, float]:
        """Mass of the body at a target [kg], and its center's distance from its joint [m]."""

    @property
    @abstractmethod
    def simulated_by(self) -> str:
        """Who simulates it, for reports."""

    def finely(self, times: int) -> Self:
        """The same in so many times as short timesteps; itself where it chooses these by error."""
        return self

    def in_steps(self, part: float = 1.0) -> Self:
        """The same as the simulator of its file moves it, in a part of the file's timestep [-].

        Of 0 it moves exactly. Itself where there is no such simulator, or one of a higher order.
        """
        return self

    def timesteps(
        self,
        start: Float[np.ndarray, "W X"],
        commands: Float[np.ndarray, "W T_all U"],
        lead: int,
        dt: float,
        every: int,
        measured: Float[np.ndarray, "W X T"],
        std: Float[np.ndarray, " X"],
    ) -> tuple[int, Float[np.ndarray, " X"]]:
        """How many times as short timesteps do less than the noise, and what they still do.

        Equations keep their error small by themselves. Arguments are those of `run`, what was
        measured of these motions, and the std of its noise, in each state's unit.

        Raises:
            InputError: most of the motions run away, even so.
        """
        return 1, np.zeros(len(std))

    @property
    def timestep_s(self) -> float:
        """Of a simulation that does not choose its timesteps for their error [s]; else 0."""
        return 0.0

    @property
    @abstractmethod
    def least_s(self) -> float:
        """Delays and lags that are shorter are nothing to it [s]."""

    @property
    def costly(self) -> bool:
        """Whether a second of it takes far longer to simulate than one of a pendulum."""
        return len(self.layout.joints) > MANY

    def actuation(
        self, q: Float[np.ndarray, "N J"], v: Float[np.ndarray, "N J"], u: Float[np.ndarray, "N U"]
    ) -> Float[np.ndarray, "N J"] | None:
        """Forces of actuators and contacts on the joints [N or N m]; None: gain times command."""
        return None

    def beside(
        self, y: Float[np.ndarray, "... X T"], measured: Float[np.ndarray, "... X T"]
    ) -> Float[np.ndarray, "... X T"]:
        """Simulated states, angles counted so that their distance from measured ones is short."""
        return y

    @property
    def rest(self) -> Float[np.ndarray, " X"]:
        """The state in which it is where nothing is known of it."""
        return np.zeros(len(self.layout.states))

    def simulate(
        self,
        start: Float[np.ndarray, "B X"],
        inputs: Float[np.ndarray, "B T U"],
        dt: float,
        parameters: Mapping[str, Float[np.ndarray, " B"]] | None = None,
    ) -> Float[np.ndarray, "B T_plus_1 X"]:
        """The measured states of B motions, NaN from where one runs away.

        The states `start` are in the order of `layout.states`; commands are held for dt [s] each;
        `parameters` are values that differ from the nominal ones, for each motion.

        Raises:
            InputError: a name of a parameter that it does not have.
        """
        rows = np.tile(self.nominal, (len(start), 1))
        for name, values in (parameters or {}).items():
            rows[:, self._column(name)] = values
        rows, system = distinct_rows(rows)
        each = np.arange(len(start))
        commands = np.pad(inputs, ((0, 0), (0, 1), (0, 0)))  # none follows the last sample
        y = self.run(self.tables(rows), system, np.array(start, float), each, commands, 0, dt)
        return y.transpose(0, 2, 1)

    def _at(self, active: EffectInstance, rows: Iterator[int]) -> int:
        """Where an effect writes: its row among the forces, or the number of its target."""
        if isinstance(active.effect, JointForce):
            return next(rows)
        places = {"joint": "joints", "body": "bodies", "actuator": "actuators", "sensor": "states"}
        return getattr(self.layout, places[active.effect.place]).index(active.target)

    def _column(self, name: str) -> int:
        names = [parameter.name for parameter in self.parameters]
        if name not in names:
            raise InputError(f"{self.name} has no parameter {name!r}; it has {', '.join(names)}.")
        return names.index(name)


@dataclass(frozen=True)
class FirstOrder:
    """An integrator of first order, which moves positions by the velocities at the end of a step.

    To first order in the timestep h its motion is the exact one of another machine: positions are
    those of h / 2 later than velocities and commands, and a damping d that is taken at the end of a
    step is inertia d h / 2 besides, or less by as much where it is taken at the beginning. What
    forces of Coriolis do, which are taken at the beginning too, is left out.

    Reference: Hairer, Lubich & Wanner, Geometric Numerical Integration (2006), sections I.1, IX.1.
    """

    timestep_s: float
    """h [s]"""
    inertia: tuple[float, ...]
    """that damping is besides in each joint [kg or kg m^2]"""


@dataclass(frozen=True)
class ChainPlant(Plant):
    """A plant by its equations: an open chain of hinges and slides, compiled, with derivatives."""

    build: Callable[[Mapping[str, float]], Chain]
    """the bodies, of values of the parameters"""
    file_timestep_s: float = 0.0
    """of the model that it was read from [s]; 0: none"""
    integrator: FirstOrder | None = None
    """of the simulator of that model, where it is one of first order"""
    stepped: float = 0.0
    """part of the timestep in which it moves as by that integrator [-], see `in_steps`"""

    @property
    def least_s(self) -> float:
        return self.file_timestep_s if self.stepped else 0.0

    def in_steps(self, part: float = 1.0) -> Self:
        return self if self.integrator is None else replace(self, stepped=part)

    @property
    def chain(self) -> Chain:
        """The bodies, with the nominal values."""
        return self._built(self.values)

    def _built(self, values: Mapping[str, float]) -> Chain:
        """The bodies as they move, of values of the parameters."""
        chain = self.build(values)
        if not (self.stepped and self.integrator):
            return chain
        bodies = tuple(
            replace(body, armature=body.armature + self.stepped * extra)
            for body, extra in zip(chain.bodies, self.integrator.inertia, strict=True)
        )
        return replace(chain, bodies=bodies)

    @property
    def gains(self) -> list[float]:
        """The force that each input asks for, a unit of it [N or N m a unit]."""
        return self.tables(self.nominal[None]).actuators[0, :, GAIN].tolist()

    def tables(
        self,
        parameters: Float[np.ndarray, "S P"],
        actives: Sequence[EffectInstance] = (),
        values: Sequence[Float[np.ndarray, "S _"]] = (),
        grids: Sequence[tuple[str, tuple[Axis, ...]]] = (),
        weights: Sequence[Float[np.ndarray, "S _"]] = (),
    ) -> Tables:
        S, names = len(parameters), [parameter.name for parameter in self.parameters]
        everything = [base.active for base in self.base] + [a for a, _ in self.added] + [*actives]
        forces = [(a.effect, a.target) for a in everything if isinstance(a.effect, JointForce)]
        different, which = distinct_rows(parameters)  # most systems share their bodies
        built = [self._built(dict(zip(names, row, strict=True))) for row in different]
        chains = stack(built, which)
        tables = self._blank(chains, forces, S, grids, weights)
        rows = iter(range(len(forces)))
        places = [self._at(active, rows) for active in everything]
        for s, row in enumerate(parameters):
            known = dict(zip(names, row, strict=True))
            each: list[Sequence[float]] = [
                [known[v] if isinstance(v, str) else v for v in base.values] for base in self.base
            ]
            each += [added for _, added in self.added] + [value[s] for value in values]
            for active, at, numbers in zip(everything, places, each, strict=True):
                active.effect.install(tables, s, at, numbers)
        return tables

    def run(
        self,
        tables: Tables,
        system: Int[np.ndarray, " B"],
        start: Float[np.ndarray, "B X"],
        window: Int[np.ndarray, " B"],
        commands: Float[np.ndarray, "W T_all U"],
        lead: int,
        dt: float,
        taken: Int[np.ndarray, " 1"] | None = None,
        every: int = 1,
        path: Float[np.ndarray, "W lead_plus_1 X"] | None = None,
        accuracy: float = 1.0,
    ) -> Float[np.ndarray, "B X T"]:
        given = tables, system, start, window, commands, lead, dt, taken, every, path
        return simulate(*given, accuracy)

    @property
    def simulated_by(self) -> str:
        return "its equations of motion, without contacts and limits of joints"

    def actuation(
        self, q: Float[np.ndarray, "N J"], v: Float[np.ndarray, "N J"], u: Float[np.ndarray, "N U"]
    ) -> Float[np.ndarray, "N J"] | None:
        if not self.layout.servos:
            return None
        forces, rows = np.zeros_like(q), self.tables(self.nominal[None]).actuators[0]
        for row, j, x in zip(rows, self.layout.drives, u.T, strict=True):
            forces[:, j] += SERVED(row, row[GAIN] * x, q[:, j], v[:, j])
        return forces

    def mass_matrix(self, q: Float[np.ndarray, "N J"]) -> Float[np.ndarray, "N J J"]:
        return mass_matrix(self.chain, q)

    def weights(self, q: Float[np.ndarray, "N J"]) -> Float[np.ndarray, "N J"]:
        return generalised_forces(self.chain, q, np.zeros_like(q), np.zeros_like(q))

    def mass_and_length(self, target: str) -> tuple[float, float]:
        body = self.chain.bodies[self.layout.joint_of(target)]
        return body.mass, float(np.linalg.norm(body.center))

    def stepper(self, dt: float, batch: int, samples: int = 1) -> Stepper:
        """As many motions, all in the state 0, to be moved by one command after another.

        A command is held for dt [s]; `samples` states are returned of one step.
        """
        return Stepper(self.tables(self.nominal[None]), dt, batch, samples)
