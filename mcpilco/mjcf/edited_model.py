"""A MuJoCo model that effects are written into, as a specification for a file or compiled already.

The same lines of an effect (`Effect.write_mjcf`) write `corrected.xml` and make the systems that
`MujocoPlant` simulates, so that both move alike.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.polynomial import Polynomial

from mcpilco.mjcf.inertials import Inertials
from mcpilco.plant import FASTEST, Layout

FAR = 1e6
"""where a spring rests that pulls with a constant force [m or rad]"""
RIGID = (0.999, 0.9999, 0.001, 0.5, 2.0)
"""solimpfriction of a joint that gets dry friction: MuJoCo's own lets it creep far more [-]"""
SUDDEN = (1e-4, 1.0)
"""its solreffriction: MuJoCo's own lets go of a joint over 10 ms as it stops; two timesteps are the
least that MuJoCo takes [s, -]"""
FILTERED = "the command is filtered before it reaches the model"
"""why a model that MuJoCo simulates takes no lag and no delay"""
DAMPING_TIME = "damping_time"
"""how the name of the parameter ends that is gear times kv over kp of a position servo [s]"""


class EditedModel(ABC):
    """A model that effects are written into, one after another."""

    def __init__(self, model: mujoco.MjModel, layout: Layout) -> None:
        self._layout, self._model = layout, model
        self.inertials = Inertials(model)
        self._springs: dict[str, Polynomial] = {}
        """of the joints whose spring is changed"""
        self._strength = float(np.linalg.norm(model.opt.gravity))

    @abstractmethod
    def joint(self, name: str) -> Any:
        """A joint: damping, stiffness, frictionloss, armature and how its friction is solved."""

    @abstractmethod
    def actuator(self, name: str) -> Any:
        """An actuator: gear, gainprm, biasprm and ranges."""

    @abstractmethod
    def body(self, number: int) -> Any:
        """A body: its pos."""

    @abstractmethod
    def geoms(self) -> Iterable[Any]:
        """The geoms: bodyid, pos, friction and solref of each."""

    @abstractmethod
    def pairs(self) -> Iterable[Any]:
        """The explicit pairs of geoms: friction and solref of each."""

    @property
    @abstractmethod
    def option(self) -> Any:
        """Its options: gravity."""

    @abstractmethod
    def rests_at(self, joint: str, rest: float) -> None:
        """Lets the spring of a joint be without force at a position [m or rad]."""

    def limit(self, actuator: str, largest: float) -> str | None:
        """Lets an actuator give no more than a force [N or N m], or says why it cannot."""
        element = self.actuator(actuator)
        most = largest / max(abs(float(element.gear[0])), 1e-12)
        if math.isfinite(most):
            free = (-math.inf, math.inf)
            low, high = element.forcerange if is_limited(element, "force") else free
            element.forcerange = np.array([max(low, -most), min(high, most)])
            element.forcelimited = 1
        return None

    def lag(self, actuator: str, lag: float) -> str | None:
        """Lets an actuator lag behind its command by a time constant [s], or says why not."""
        return FILTERED

    def delay(self, actuator: str, delay: float) -> str | None:
        """Delays the command of an actuator [s], or says why it cannot."""
        return FILTERED

    def set(self, name: str, value: float) -> None:
        """Gives a parameter of the plant another value."""
        owner, _, what = name.rpartition("_")
        if name == "gravity":
            self.option.gravity = np.asarray(self.option.gravity) * value / self._strength
        elif name.endswith(DAMPING_TIME):
            element = self.actuator(self._named(name.removesuffix(f"_{DAMPING_TIME}")))
            element.biasprm[2] = -value * element.gainprm[0] / element.gear[0]
        elif what == "mass":
            self.inertials.scale_to(owner, value)
        elif what == "damping":
            put(self.joint(owner), "damping", 0, value)
        elif what == "friction":
            self.joint(owner).frictionloss = value
        else:
            actuator = self._named(owner)
            self.multiply_gain(actuator, value / self.gain(actuator))

    def _named(self, command: str) -> str:
        """The actuator of an input."""
        return self._layout.actuator(self._layout.inputs.index(command))

    def finish(self) -> None:
        """Writes what several effects share."""
        for name, force in self._springs.items():
            rest, stiffness = _about_rest(force)
            for power, value in enumerate(stiffness):
                put(self.joint(name), "stiffness", power, value)
            self.rests_at(name, rest)

    def add_force(self, joint: str, force: Callable[[Any, Any], Any]) -> bool:
        """Adds a force of position and velocity to a joint; False if MJCF has no such force.

        MJCF has a polynomial of the position to the third power, one of the speed against the
        motion, and dry friction.
        """
        try:
            terms = (force(_Terms({(1, 0, 0): 1.0}), _Terms({(0, 1, 1): 1.0})) + _Terms({})).terms
        except TypeError:
            return False
        springs, dampers, dry = Polynomial([0.0]), np.zeros(3), 0.0
        for (power, speeds, sign), size in terms.items():
            if power <= 3 and speeds == 0 and not sign:
                springs = springs + size * Polynomial([0.0, 1.0]) ** power
            elif power == 0 and 1 <= speeds <= 3 and sign:
                dampers[speeds - 1] -= size
            elif power == 0 and speeds == 0 and sign and size <= 0.0:
                dry -= size
            elif size:
                return False
        element = self.joint(joint)
        if springs.coef.any():
            number = int(self._model.dof_jntid[self._layout.joints.index(joint)])
            before = self._springs.get(joint, _spring(self._model, number))
            self._springs[joint] = before + springs
        if dry and element.frictionloss == 0.0:
            element.solimp_friction, element.solref_friction = RIGID, SUDDEN
        element.frictionloss += dry
        for index, more in enumerate(dampers):
            if more:
                put(element, "damping", index, element.damping[index] + more)
        return True

    def gain(self, actuator: str) -> float:
        """The force of an actuator for a unit of its command."""
        element = self.actuator(actuator)
        return float(element.gear[0] * element.gainprm[0])

    def multiply_gain(self, actuator: str, factor: float) -> None:
        """Multiplies the force of an actuator, whose ranges stay what they are."""
        element = self.actuator(actuator)
        element.gainprm[:3] *= factor
        element.biasprm[:3] *= factor

    def lengthen(self, body: str, more: float) -> str | None:
        """Takes what a body carries further from its joint [m]."""
        for number, shift in self.inertials.shifts(body, more):
            element = self.body(number)
            element.pos = np.asarray(element.pos) + shift
        return None

    def scale_contacts(self, friction: float = 1.0, stiffness: float = 1.0, damping: float = 1.0):
        """Multiplies sliding friction, stiffness and damping of all contacts.

        A negative `solref` is stiffness and damping; a positive one the time constant T of a
        contact and its damping ratio z: stiffness is as 1 / (T z)^2, damping as 1 / T.
        """
        for element in (*self.geoms(), *self.pairs()):
            sliding = 2 if len(element.friction) > 3 else 1  # of a pair, in both directions
            element.friction[:sliding] *= friction
            if element.solref[0] > 0.0:
                element.solref[0] /= damping
                element.solref[1] *= damping / math.sqrt(stiffness)
            else:
                element.solref[:] *= stiffness, damping

    def raise_ground(self, more: float) -> None:
        """Lifts all that never moves [m]."""
        bodies = [b for b in range(1, self._model.nbody) if self._model.body_weldid[b] == 0]
        roots = [b for b in bodies if self._model.body_parentid[b] == 0]
        fixed = [geom for geom in self.geoms() if geom_body(geom) == 0]
        for element in (*fixed, *map(self.body, roots)):
            element.pos = np.asarray(element.pos) + np.array([0.0, 0.0, more])


def geom_body(geom: Any) -> int:
    """The number of the body of a geom."""
    return int(np.ravel(geom.bodyid)[0]) if hasattr(geom, "bodyid") else int(geom.parent.id)


def is_limited(actuator: Any, what: str) -> bool:
    """Whether the `ctrl` or the `force` of an actuator has a range."""
    low, high = getattr(actuator, f"{what}range")
    kind = int(np.ravel(getattr(actuator, f"{what}limited"))[0])
    auto = kind == int(mujoco.mjtLimited.mjLIMITED_AUTO)
    return bool(low < high if auto else kind)


def put(element: Any, attribute: str, index: int, value: float) -> None:
    """Sets one number of an attribute that is an array."""
    numbers = np.array(getattr(element, attribute))
    numbers[index] = value
    setattr(element, attribute, numbers)


class _Terms:
    """A force as a sum of terms q^p |v|^n sign(v)^s, as far as it is one: a number for formulas.

    What is no such sum raises TypeError, as an operation that a number lacks does.
    """

    def __init__(self, terms: Mapping[tuple[int, int, int], float]) -> None:
        """The sum of the terms (p, n, s), s being 0 or 1, each with its factor."""
        self.terms = dict(terms)

    def __add__(self, other: Any) -> _Terms:
        total = dict(self.terms)
        for key, size in _terms_of(other).items():
            total[key] = total.get(key, 0.0) + size
        return _Terms(total)

    def __mul__(self, other: Any) -> _Terms:
        total = _Terms({})
        for (p, n, s), size in self.terms.items():
            for (k, m, r), factor in _terms_of(other).items():
                total = total + _Terms({(p + k, n + m, (s + r) % 2): size * factor})
        return total

    __radd__, __rmul__ = __add__, __mul__

    def __neg__(self) -> _Terms:
        return self * -1.0

    def __sub__(self, other: Any) -> _Terms:
        return self + other * -1.0

    def __rsub__(self, other: Any) -> _Terms:
        return -self + other

    def __truediv__(self, other: float) -> _Terms:
        return self * (1.0 / other)

    def __pow__(self, power: int) -> _Terms:
        if not isinstance(power, int) or power < 1:
            raise TypeError("only whole powers are terms of MJCF")
        return self if power == 1 else self * self ** (power - 1)

    def __abs__(self) -> _Terms:
        ((p, n, _), size), *more = self.terms.items()
        if more or p % 2:
            raise TypeError("|q| and the absolute value of a sum are no terms of MJCF")
        return _Terms({(p, n, 0): abs(size)})

    def tanh(self) -> _Terms:
        """sign(v), of v / v_r with a small v_r: MuJoCo's dry friction turns over as it can."""
        ((key, size), *more) = self.terms.items()
        if more or key != (0, 1, 1) or abs(size) < 1.0 / FASTEST:
            raise TypeError("a tanh that is no dry friction is no term of MJCF")
        return _Terms({(0, 0, 1): math.copysign(1.0, size)})


def _terms_of(x: Any) -> dict[tuple[int, int, int], float]:
    return x.terms if isinstance(x, _Terms) else {(0, 0, 0): float(x)}


def _spring(model: mujoco.MjModel, joint: int) -> Polynomial:
    """The force of a joint's spring, a polynomial of its position."""
    about = Polynomial([-float(model.qpos_spring[model.jnt_qposadr[joint]]), 1.0])
    higher = enumerate(model.jnt_stiffnesspoly[joint], start=2)
    return -sum((k * about**n for n, k in higher), float(model.jnt_stiffness[joint]) * about)


def _about_rest(force: Polynomial) -> tuple[float, Float[np.ndarray, " 3"]]:
    """Where a force is 0, and its stiffness there: of (q - rest), its square and its cube."""
    force = force.trim()
    if force.degree() == 0:
        push = float(force.coef[0])
        return math.copysign(FAR, push) if push else 0.0, np.array([abs(push) / FAR, 0.0, 0.0])
    roots = force.roots()
    real = roots[np.abs(roots.imag) < 1e-9 * (1.0 + np.abs(roots))].real
    rest = float(real[np.abs(real).argmin()])
    about = force(Polynomial([rest, 1.0])).coef
    return rest, -np.pad(about, (0, 4 - len(about)))[1:]
