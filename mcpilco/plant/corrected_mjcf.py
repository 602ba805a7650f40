"""A correction written into an MJCF file, as far as MJCF can say it."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.polynomial import Polynomial

from mcpilco.files import write_bytes
from mcpilco.plant.correction import Addition, Correction, corrected
from mcpilco.plant.effects.base import OUTSIDE
from mcpilco.plant.effects.joint import FASTEST
from mcpilco.plant.effects.learned import LearnedForce
from mcpilco.plant.mjcf import plant_of
from mcpilco.plant.mjcf_inertials import Inertials
from mcpilco.plant.simulation.layout import Layout
from mcpilco.typing import InputError

FAR = 1e6
"""where a spring rests that pulls with a constant force [m or rad]"""
RIGID = (0.999, 0.9999, 0.001, 0.5, 2.0)
"""solimpfriction of a joint that gets dry friction: MuJoCo's own lets it creep far more [-]"""
SUDDEN = (1e-4, 1.0)
"""its solreffriction: MuJoCo's own lets go of a joint over 10 ms as it stops; two timesteps are the
least that MuJoCo takes [s, -]"""
LEARNED = "let mcpilco.plant.passive_forces add it in MuJoCo's callback of passive forces"
"""what to do about a learned force"""


def write_corrected_mjcf(source: str | Path, correction: Correction, path: str | Path) -> list[str]:
    """Writes the model with its correction; plain MuJoCo loads it.

    MuJoCo's own writer saves it: with what the file included, without its comments, numbers to six
    digits.

    Returns:
        A sentence for each effect and learned force that MJCF cannot say, with what to do instead.

    Raises:
        InputError: the file is no plant, or the correction does not fit it.
        RunFolderError: the file cannot be written.
    """
    source, path = Path(source), Path(path)
    plant = plant_of(source)
    corrected(plant, correction)
    model = CorrectedModel(mujoco.MjSpec.from_file(str(source)), plant.layout)
    for name, value in correction.parameters.items():
        model.set(name, value)
    left = [sentence for effect in correction.effects if (sentence := model.add(effect))]
    left += [f"MJCF cannot say the {force}; {LEARNED}." for force in correction.learned]
    model.finish()
    save_mjcf(model.spec, source, path)
    return left


def save_mjcf(spec: mujoco.MjSpec, source: Path, path: Path) -> None:
    """Writes a changed model; the paths of meshes and textures still lead to their files.

    Raises:
        InputError: MuJoCo refuses the model.
        RunFolderError: the file cannot be written.
    """
    before, after = source.parent, path.parent
    if before.resolve() != after.resolve():
        for folder in ("meshdir", "texturedir"):
            old = before / getattr(spec, folder)
            setattr(spec, folder, os.path.relpath(old.resolve(), after.resolve()))
    try:
        spec.compile()
    except ValueError as error:
        raise InputError(f"{source} cannot be changed so that MuJoCo loads it: {error}") from None
    write_bytes(path, spec.to_xml().encode())


def write_joint_terms(joint: Any, terms: Mapping[str, float], degrees: bool) -> None:
    """Replaces forces of a joint; those that are not named stay.

    Terms are viscous, coulomb, armature, and the force stiffness q + offset against the motion, a
    spring about where it is 0; `degrees` says whether the model's angles are in degrees.
    """
    if "viscous" in terms:
        put(joint, "damping", 0, terms["viscous"])
    if "coulomb" in terms:
        if joint.frictionloss == 0.0 and terms["coulomb"] > 0.0:
            joint.solimp_friction, joint.solref_friction = RIGID, SUDDEN
        joint.frictionloss = terms["coulomb"]
    if "armature" in terms:
        joint.armature = terms["armature"]
    if "stiffness" in terms or "offset" in terms:
        hinge = joint.type == mujoco.mjtJoint.mjJNT_HINGE
        unit = math.radians(1.0) if hinge and degrees else 1.0
        before = float(np.ravel(joint.stiffness)[0])
        offset = terms.get("offset", -before * float(joint.springref) * unit)
        k = terms.get("stiffness", before) or abs(offset) / FAR
        put(joint, "stiffness", 0, k)
        joint.springref = -offset / k / unit if k else 0.0


class CorrectedModel:
    """A model that effects are written into, one after another, by `Effect.write_mjcf`."""

    def __init__(self, spec: mujoco.MjSpec, layout: Layout) -> None:
        spec.compiler.fusestatic = False
        self.spec = spec
        self._layout = layout
        compiled = spec.compile()
        self.inertials = Inertials(spec, compiled)
        self._joints = {j.id: j for j in spec.joints}
        self._actuators = {a.id: a for a in spec.actuators}
        self._springs = {
            name: _spring(compiled, number) for number, name in enumerate(layout.joints)
        }
        self._untouched = dict(self._springs)
        self._has_stages = spec.option.integrator == mujoco.mjtIntegrator.mjINT_RK4
        self._gravity = float(np.linalg.norm(spec.option.gravity))
        self._limits = dict.fromkeys(self._actuators, math.inf)

    def set(self, name: str, value: float) -> None:
        """Gives a parameter of the plant another value."""
        owner, _, what = name.rpartition("_")
        if name == "gravity":
            self.spec.option.gravity = np.asarray(self.spec.option.gravity) * value / self._gravity
        elif what == "mass":
            self.inertials.scale_to(owner, value)
        elif what == "damping":
            put(self.joint(owner), "damping", 0, value)
        elif what == "friction":
            self.joint(owner).frictionloss = value
        else:
            u = self._layout.inputs.index(owner)
            self._multiply(u, value / self._gain(u))

    def add(self, addition: Addition) -> str | None:
        """Writes an effect, or returns a sentence on why MJCF cannot say it."""
        values = ", ".join(f"{k} = {v:g}" for k, v in addition.parameters.items())
        named = f"{addition.name} ({addition.target}; {values})"
        fault = addition.effect.write_mjcf(self, addition.target, addition.values)
        if fault in OUTSIDE.values():
            return f"MJCF cannot say {named}; {fault}."
        return f"{named}: {fault}" if fault else None

    def finish(self) -> None:
        """Writes what several effects share."""
        for name, force in self._springs.items():
            if force is not self._untouched[name]:
                self._write_spring(name, force)
        for u, actuator in self._actuators.items():
            largest = self._limits[u] / abs(self._gain(u)) if self._gain(u) else math.inf
            low, high = actuator.ctrlrange
            if not _limited(actuator):
                low, high = -math.inf, math.inf
            if largest < max(abs(low), abs(high)):
                actuator.ctrlrange = (max(low, -largest), min(high, largest))
                actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
        self.inertials.write()

    def joint(self, name: str) -> Any:
        """The specification of a joint."""
        return self._joints[self._layout.joints.index(name)]

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
        spec = self.joint(joint)
        if springs.coef.any():
            self._springs[joint] = self._springs[joint] + springs
        if dry and spec.frictionloss == 0.0:
            spec.solimp_friction, spec.solref_friction = RIGID, SUDDEN
        spec.frictionloss += dry
        for index, more in enumerate(dampers):
            if more:
                put(spec, "damping", index, spec.damping[index] + more)
        return True

    def multiply_gain(self, actuator: str, factor: float) -> None:
        """Multiplies the force of an actuator, whose range stays what it is."""
        self._multiply(self._layout.actuators.index(actuator), factor)

    def limit(self, actuator: str, largest: float) -> None:
        """Lets an actuator give no more than a force [N or N m], in either direction."""
        u = self._layout.actuators.index(actuator)
        self._limits[u] = min(self._limits[u], largest)

    def lag(self, actuator: str, lag: float) -> None:
        """Lets an actuator lag behind its command by a time constant [s]."""
        spec = self._actuators[self._layout.actuators.index(actuator)]
        if lag > 0.0:
            # its four stages follow the lag by themselves; other integrators hold it for a timestep
            exact, plain = mujoco.mjtDyn.mjDYN_FILTEREXACT, mujoco.mjtDyn.mjDYN_FILTER
            spec.dyntype = plain if self._has_stages else exact
            spec.dynprm[0] = lag

    def delay(self, actuator: str, delay: float) -> str | None:
        """Delays the command of an actuator [s], or returns why MuJoCo cannot."""
        spec = self._actuators[self._layout.actuators.index(actuator)]
        step = self.spec.option.timestep
        if delay > 0.0:
            # interpolated linearly, a jump takes the timestep before it: its mean is right where
            # the force is held for a timestep, and half a timestep early where it is not
            spec.delay = delay + (0.5 * step if self._has_stages else 0.0)
            spec.nsample = math.ceil(spec.delay / step) + 2
            spec.interp = 1
        if 0.0 < delay < step:
            return f"MuJoCo delays by a timestep of {step:g} s at least; choose a shorter one."
        return None

    def _gain(self, u: int) -> float:
        return float(self._actuators[u].gear[0] * self._actuators[u].gainprm[0])

    def _multiply(self, u: int, factor: float) -> None:
        self._actuators[u].gainprm[0] *= factor  # a range of its force stays what it is

    def _write_spring(self, name: str, force: Polynomial) -> None:
        """Says a joint's force, a polynomial of its position, as a spring about where it is 0."""
        joint = self.joint(name)
        rest, stiffness = _about_rest(force)
        for power, value in enumerate(stiffness):
            put(joint, "stiffness", power, value)
        hinge = joint.type == mujoco.mjtJoint.mjJNT_HINGE
        joint.springref = math.degrees(rest) if hinge and self.spec.compiler.degree else rest


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
    rest = float(model.qpos_spring[model.jnt_qposadr[joint]])
    return -float(model.jnt_stiffness[joint]) * Polynomial([-rest, 1.0])


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


def put(element: Any, attribute: str, index: int, value: float) -> None:
    """Sets one number of an attribute that is an array."""
    numbers = np.array(getattr(element, attribute))
    numbers[index] = value
    setattr(element, attribute, numbers)


def _limited(actuator: Any) -> bool:
    low, high = actuator.ctrlrange
    auto = actuator.ctrllimited == mujoco.mjtLimited.mjLIMITED_AUTO
    return bool(low < high if auto else actuator.ctrllimited)


def passive_forces(
    model: mujoco.MjModel, forces: Sequence[LearnedForce]
) -> Callable[[mujoco.MjModel, mujoco.MjData], None]:
    """A callback that adds learned forces to `data.qfrc_passive`, at every stage of a step.

    MuJoCo calls it after `mujoco.set_mjcb_passive(callback)`, for all models of the process; those
    with other names are not for it. `mujoco.set_mjcb_passive(None)` takes it away.

    The model's motors have constant gains; the forces, `Correction.learned`, are of a plant of this
    model.

    Raises:
        InputError: a force at a joint, or over a state or input, that the model does not have.
    """
    joints = [model.joint(j).name or f"joint{j}" for j in range(model.njnt)]
    inputs = [model.actuator(u).name or f"actuator{u}" for u in range(model.nu)]
    states = [f"{joint}_{what}" for joint in joints for what in ("position", "velocity")]
    for force in forces:
        unknown = {force.joint} - {*joints} or {a.of for a in force.axes} - {*states, *inputs}
        if unknown:
            raise InputError(
                f"the model has no joint, state or input {unknown.pop()!r}; it has "
                f"{', '.join((*joints, *states, *inputs))}."
            )

    def value(data: mujoco.MjData, name: str) -> float:
        if name in inputs:
            return _drive(model, data, inputs.index(name))
        j = states.index(name) // 2
        if name.endswith("_position"):
            return float(data.qpos[model.jnt_qposadr[j]])
        return float(data.qvel[model.jnt_dofadr[j]])

    def push(called: mujoco.MjModel, data: mujoco.MjData) -> None:
        for force in forces:
            at = (np.array([value(data, axis.of)]) for axis in force.axes)
            data.qfrc_passive[model.jnt_dofadr[joints.index(force.joint)]] += force.at(*at)[0]

    return push


def _drive(model: mujoco.MjModel, data: mujoco.MjData, u: int) -> float:
    """Force of a motor at its joint, of its command now."""
    command = float(data.ctrl[u])
    if model.actuator_ctrllimited[u]:
        command = float(np.clip(command, *model.actuator_ctrlrange[u]))
    force = float(model.actuator_gainprm[u, 0]) * command
    if model.actuator_forcelimited[u]:
        force = float(np.clip(force, *model.actuator_forcerange[u]))
    return float(model.actuator_gear[u, 0]) * force
