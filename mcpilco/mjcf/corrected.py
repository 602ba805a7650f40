"""A correction written into an MJCF file, as far as MJCF can say it."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from mcpilco.files import write_bytes
from mcpilco.mjcf.edited_model import FAR, RIGID, SUDDEN, EditedModel, is_limited, put
from mcpilco.mjcf.mujoco.callbacks import write_callbacks
from mcpilco.mjcf.mujoco.plant import MujocoPlant
from mcpilco.mjcf.mujoco.read import read_plant
from mcpilco.plant import (
    OUTSIDE,
    Addition,
    Correction,
    EffectInstance,
    Layout,
    LearnedForce,
    Plant,
    corrected,
)
from mcpilco.typing import InputError

LEARNED = "let mcpilco.mjcf.passive_forces add it in MuJoCo's callback of passive forces"
"""what to do about a learned force"""


def write_corrected_mjcf(
    source: str | Path, correction: Correction, path: str | Path, plant: Plant | None = None
) -> list[str]:
    """Writes the model with its correction; plain MuJoCo loads it.

    MuJoCo's own writer saves it: with what the file included, without its comments. What MJCF
    cannot say of a plant that MuJoCo simulates is written beside it, as a Python module whose
    `install(model)` lets MuJoCo's callback add it.

    Args:
        source: the file of the model.
        correction: of its plant.
        path: where the corrected model goes.
        plant: the nominal one; None: as `read_plant` reads the file.

    Returns:
        A sentence for each effect and learned force that MJCF cannot say, with what to do instead.

    Raises:
        InputError: the file is no plant, or the correction does not fit it.
        RunFolderError: the file cannot be written.
    """
    source, path = Path(source), Path(path)
    plant = plant or read_plant(source)
    whole = corrected(plant, correction)
    spec = mujoco.MjSpec.from_file(str(source))
    filtered = whole if isinstance(whole, MujocoPlant) else None
    model = (CorrectedModel if filtered is None else _FilteredModel)(spec, plant.layout)
    for name, value in correction.parameters.items():
        model.set(name, value)
    left = []
    for effect in correction.effects:
        said = filtered is None or filtered.says(EffectInstance(effect.effect, effect.target))
        if said and (sentence := model.add(effect)):
            left.append(sentence)
    model.finish()
    save_mjcf(model.spec, source, path)
    if filtered is not None:
        return [*left, *write_callbacks(path.with_suffix(".py"), filtered)]
    return [*left, *(f"MJCF cannot say the {force}; {LEARNED}." for force in correction.learned)]


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
    write_bytes(path, _sharpened(spec.to_xml(), spec))


def _sharpened(xml: str, spec: mujoco.MjSpec) -> bytes:
    """A model as MuJoCo writes it, with the numbers whose six digits it writes.

    Elements stand in the file in the order of their numbers.
    """
    root = ElementTree.fromstring(xml)
    world = root.find("worldbody")
    for tag, elements, names in (
        ("body", spec.bodies, ("pos",)),
        ("geom", spec.geoms, ("pos", "friction", "solref")),
        ("joint", spec.joints, ("damping", "stiffness", "armature", "frictionloss")),
    ):
        nodes = [] if world is None else [n for n in world.iter() if n.tag in (tag, f"free{tag}")]
        ordered = sorted(elements, key=lambda element: element.id)[tag == "body" :]
        for node, element in zip(nodes, ordered, strict=True) if len(nodes) == len(ordered) else ():
            _sharpen(node, element, dict(zip(names, names, strict=True)))
            inertial = node.find("inertial")
            if tag == "body" and inertial is not None:
                own = {"mass": "mass", "pos": "ipos", "quat": "iquat", "diaginertia": "inertia"}
                _sharpen(inertial, element, own)
    return ElementTree.tostring(root)


def _sharpen(node: ElementTree.Element, element: Any, names: Mapping[str, str]) -> None:
    for name, own in names.items():
        written = np.array(node.get(name, "").split(), dtype=float)
        numbers = np.ravel(getattr(element, own))[: len(written)]
        same = 0 < len(written) == len(numbers)
        if same and np.allclose(written, numbers, rtol=2e-5, atol=1e-12):
            node.set(name, " ".join(map(repr, map(float, numbers))))


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


class CorrectedModel(EditedModel):
    """A model's specification, which is written to a file."""

    def __init__(self, spec: mujoco.MjSpec, layout: Layout) -> None:
        spec.compiler.fusestatic = False
        self.spec = spec
        super().__init__(spec.compile(), layout)
        self._joints = {j.id: j for j in spec.joints}
        by_number = sorted(spec.actuators, key=lambda actuator: actuator.id)
        self._actuators = dict(zip(layout.actuators, by_number, strict=True))
        self._bodies = {b.id: b for b in spec.bodies}
        self._has_stages = spec.option.integrator == mujoco.mjtIntegrator.mjINT_RK4
        self._limits = dict.fromkeys(self._actuators, math.inf)

    @property
    def option(self) -> Any:
        return self.spec.option

    def joint(self, name: str) -> Any:
        return self._joints[self._model.dof_jntid[self._layout.joints.index(name)]]

    def actuator(self, name: str) -> Any:
        return self._actuators[name]

    def body(self, number: int) -> Any:
        return self._bodies[number]

    def geoms(self) -> Iterable[Any]:
        return self.spec.geoms

    def pairs(self) -> Iterable[Any]:
        return self.spec.pairs

    def rests_at(self, joint: str, rest: float) -> None:
        element = self.joint(joint)
        hinge = element.type == mujoco.mjtJoint.mjJNT_HINGE
        element.springref = math.degrees(rest) if hinge and self.spec.compiler.degree else rest

    def add(self, addition: Addition) -> str | None:
        """Writes an effect, or returns a sentence on why MJCF cannot say it."""
        values = ", ".join(f"{k} = {v:g}" for k, v in addition.parameters.items())
        named = f"{addition.name} ({addition.target}; {values})"
        fault = addition.effect.write_mjcf(self, addition.target, addition.values)
        if fault in OUTSIDE.values():
            return f"MJCF cannot say {named}; {fault}."
        return f"{named}: {fault}" if fault else None

    def finish(self) -> None:
        super().finish()
        for name, actuator in self._actuators.items():
            gain = abs(self.gain(name))
            largest = self._limits[name] / gain if gain else math.inf
            low, high = actuator.ctrlrange
            if not is_limited(actuator, "ctrl"):
                low, high = -math.inf, math.inf
            if largest < max(abs(low), abs(high)):
                actuator.ctrlrange = (max(low, -largest), min(high, largest))
                actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
        self.inertials.write(self.spec)

    def limit(self, actuator: str, largest: float) -> str | None:
        self._limits[actuator] = min(self._limits[actuator], largest)
        return None

    def lag(self, actuator: str, lag: float) -> str | None:
        spec = self._actuators[actuator]
        if lag > 0.0:
            # its four stages follow the lag by themselves; other integrators hold it for a timestep
            exact, plain = mujoco.mjtDyn.mjDYN_FILTEREXACT, mujoco.mjtDyn.mjDYN_FILTER
            spec.dyntype = plain if self._has_stages else exact
            spec.dynprm[0] = lag
        return None

    def delay(self, actuator: str, delay: float) -> str | None:
        spec = self._actuators[actuator]
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


class _FilteredModel(CorrectedModel):
    """That of a plant which MuJoCo simulates: commands are filtered before they reach it."""

    limit, lag, delay = EditedModel.limit, EditedModel.lag, EditedModel.delay


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
