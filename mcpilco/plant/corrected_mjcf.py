"""A correction written into an MJCF file, as far as MJCF can say it."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.polynomial import Polynomial

from mcpilco.files import write_bytes
from mcpilco.plant.correction import Addition, Correction, corrected
from mcpilco.plant.effects import CATALOGUE
from mcpilco.plant.mjcf import plant_of
from mcpilco.plant.mjcf_inertials import Inertials
from mcpilco.plant.simulation import Layout
from mcpilco.typing import InputError

FAR = 1e6
"""where a spring rests that pulls with a constant force [m or rad]"""
RIGID = (0.999, 0.9999, 0.001, 0.5, 2.0)
"""solimpfriction of a joint that gets dry friction: MuJoCo's own lets it creep far more [-]"""
SUDDEN = (1e-4, 1.0)
"""its solreffriction: MuJoCo's own lets go of a joint over 10 ms as it stops; two timesteps are the
least that MuJoCo takes [s, -]"""
OUTSIDE = {
    "actuator": "apply it to the command before that is written to ctrl",
    "joint": "add its force to qfrc_applied before each step",
    "body": "change the body's geometry instead",
    "sensor": "apply it to what is measured",
}
"""what to do about an effect that MJCF cannot say, by its place"""
LEARNED = (
    "let mcpilco.plant.learned_mjcf.passive_forces add it in MuJoCo's callback of passive forces"
)
"""what to do about a learned force"""


def write_corrected_mjcf(source: str | Path, correction: Correction, path: str | Path) -> list[str]:
    """Writes the model with its correction; plain MuJoCo loads it.

    MuJoCo's own writer saves it: with what the file included, without its comments, numbers to six
    digits.

    Args:
        source: MJCF file of the nominal model.
        correction: of the plant that this file is.
        path: the file to write.

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
    move_assets(model.spec, source.parent, path.parent)
    try:
        model.spec.compile()
    except ValueError as error:
        raise InputError(f"{source} cannot be corrected so that MuJoCo loads it: {error}") from None
    write_bytes(path, model.spec.to_xml().encode())
    return left


def move_assets(spec: mujoco.MjSpec, before: Path, after: Path) -> None:
    """Lets the paths of meshes and textures lead to their files from another folder."""
    if before.resolve() == after.resolve():
        return
    for folder in ("meshdir", "texturedir"):
        old = before / getattr(spec, folder)
        setattr(spec, folder, os.path.relpath(old.resolve(), after.resolve()))


class CorrectedModel:
    """A model that effects are written into, one after another."""

    def __init__(self, spec: mujoco.MjSpec, layout: Layout) -> None:
        spec.compiler.fusestatic = False
        self.spec = spec
        self._layout = layout
        compiled = spec.compile()
        self._inertials = Inertials(spec, compiled)
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
            self._inertials.scale_to(owner, value)
        elif what == "damping":
            put(self._joint(owner), "damping", 0, value)
        elif what == "friction":
            self._joint(owner).frictionloss = value
        else:
            u = self._layout.inputs.index(owner)
            self._multiply(u, value / self._gain(u))

    def add(self, effect: Addition) -> str | None:
        """Writes an effect, or returns a sentence on why MJCF cannot say it."""
        write: Callable[..., str | None] | None = getattr(self, f"_{effect.name}", None)
        values = ", ".join(f"{k} = {v:g}" for k, v in effect.parameters.items())
        name = f"{effect.name} ({effect.target}; {values})"
        if write is None:
            return f"MJCF cannot say {name}; {OUTSIDE[CATALOGUE[effect.name].place]}."
        fault = write(effect.target, *effect.values)
        return f"{name}: {fault}" if fault else None

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
        self._inertials.write()

    # joints

    def _viscous_friction(self, joint: str, b: float) -> None:
        put(self._joint(joint), "damping", 0, self._joint(joint).damping[0] + b)

    def _quadratic_drag(self, joint: str, c: float) -> None:
        put(self._joint(joint), "damping", 1, self._joint(joint).damping[1] + c)

    def _coulomb_friction(self, joint: str, f_c: float, v_r: float) -> None:
        spec = self._joint(joint)
        if spec.frictionloss == 0.0 and f_c > 0.0:
            spec.solimp_friction, spec.solref_friction = RIGID, SUDDEN
        spec.frictionloss += f_c

    def _asymmetric_friction(self, joint: str, f_p: float, f_n: float, v_r: float) -> None:
        # -f_p and +f_n are a friction of their mean, and a force that is there at rest too
        self._coulomb_friction(joint, 0.5 * (f_p + f_n), v_r)
        self._constant_force(joint, 0.5 * (f_n - f_p))

    def _spring(self, joint: str, k: float) -> None:
        self._springs[joint] = self._springs[joint] - Polynomial([0.0, k])

    def _hardening_spring(self, joint: str, k_3: float) -> None:
        self._springs[joint] = self._springs[joint] - Polynomial([0.0, 0.0, 0.0, k_3])

    def _constant_force(self, joint: str, f_0: float) -> None:
        self._springs[joint] = self._springs[joint] + f_0

    def _armature(self, joint: str, inertia: float) -> None:
        self._joint(joint).armature += inertia

    # bodies

    def _body_mass(self, body: str, more: float) -> None:
        self._inertials.add_mass(body, more)

    def _center_of_mass(self, body: str, further: float) -> None:
        self._inertials.move_center(body, further)

    def _body_inertia(self, body: str, more: float) -> str | None:
        return self._inertials.add_inertia(body, more)

    # actuators

    def _actuator_gain(self, target: str, k: float) -> None:
        self._multiply(self._layout.actuators.index(target), k)

    def _actuator_saturation(self, target: str, largest: float) -> None:
        u = self._layout.actuators.index(target)
        self._limits[u] = min(self._limits[u], largest)

    def _actuator_lag(self, target: str, lag: float) -> None:
        actuator = self._actuators[self._layout.actuators.index(target)]
        if lag > 0.0:
            # its four stages follow the lag by themselves; other integrators hold it for a timestep
            exact, plain = mujoco.mjtDyn.mjDYN_FILTEREXACT, mujoco.mjtDyn.mjDYN_FILTER
            actuator.dyntype = plain if self._has_stages else exact
            actuator.dynprm[0] = lag

    def _actuator_delay(self, target: str, delay: float) -> str | None:
        actuator = self._actuators[self._layout.actuators.index(target)]
        step = self.spec.option.timestep
        if delay > 0.0:
            # interpolated linearly, a jump takes the timestep before it: its mean is right where
            # the force is held for a timestep, and half a timestep early where it is not
            actuator.delay = delay + (0.5 * step if self._has_stages else 0.0)
            actuator.nsample = math.ceil(actuator.delay / step) + 2
            actuator.interp = 1
        if 0.0 < delay < step:
            return f"MuJoCo delays by a timestep of {step:g} s at least; choose a shorter one."
        return None

    def _joint(self, name: str) -> Any:
        return self._joints[self._layout.joints.index(name)]

    def _gain(self, u: int) -> float:
        return float(self._actuators[u].gear[0] * self._actuators[u].gainprm[0])

    def _multiply(self, u: int, factor: float) -> None:
        self._actuators[u].gainprm[0] *= factor  # a range of its force stays what it is

    def _write_spring(self, name: str, force: Polynomial) -> None:
        """Says a joint's force, a polynomial of its position, as a spring about where it is 0."""
        joint = self._joint(name)
        rest, stiffness = _about_rest(force)
        for power, value in enumerate(stiffness):
            put(joint, "stiffness", power, value)
        hinge = joint.type == mujoco.mjtJoint.mjJNT_HINGE
        joint.springref = math.degrees(rest) if hinge and self.spec.compiler.degree else rest


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
