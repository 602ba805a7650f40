"""A MuJoCo model as a plant: the same equations, with names for recordings and nominal effects.

Contacts and the limits of joints are not simulated: a recording in which the machine touches
something is compared with one that does not. `mcpilco gap` leaves out where a joint is stopped.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from mcpilco.bodies import HINGE, SLIDE, Body, Chain, Matrix, Vector
from mcpilco.config import TURN_OVER
from mcpilco.mjcf.edited_model import DAMPING_TIME
from mcpilco.mjcf.inertials import matrix_of
from mcpilco.plant import (
    CATALOGUE,
    Base,
    ChainPlant,
    CommandRange,
    EffectInstance,
    FirstOrder,
    Layout,
    Parameter,
    Servo,
    SoftFriction,
)
from mcpilco.typing import InputError

logger = logging.getLogger(__name__)
mujoco.set_mju_user_warning(logger.warning)  # else MUJOCO_LOG.TXT is written where the user is

MOST_ELEMENTS = 100_000
"""bodies, joints, geoms and all else of a model, copies included; large robots have thousands"""
COPYING = ("replicate", "composite", "flexcomp")
"""elements of MJCF that make `count` copies of what is in them"""
CONSTANTS = (
    *("body_mass", "body_inertia", "body_pos", "jnt_pos", "jnt_axis", "jnt_stiffness"),
    *("dof_damping", "dof_armature", "dof_frictionloss", "actuator_gear", "actuator_gainprm"),
)
"""arrays of a model that its motion is computed from"""
SWITCHES = sum(
    int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}", 0))
    for name in ("GRAVITY", "SPRING", "DAMPER", "PASSIVE", "FRICTIONLOSS", "CLAMPCTRL", "ACTUATION")
)
"""options of a model that switch off what a plant has"""


def load_mjcf(path: str | Path, wanted: str = "--model must be an MJCF file") -> mujoco.MjModel:
    """The model in a file, once it is sure that MuJoCo can hold it.

    The message begins with `wanted` where there is no such file.

    Raises:
        InputError: there is no such file, MuJoCo cannot load it, it has more than `MOST_ELEMENTS`,
            or a number in it is not finite.
    """
    if not Path(path).is_file():
        raise InputError(f"{wanted}, got {str(path)!r}, which is no file.")
    _require_affordable(Path(path))
    with warnings_of_mujoco() as said:
        try:
            model = mujoco.MjModel.from_xml_path(str(path))
        except (ValueError, mujoco.FatalError) as error:
            raise _unloadable(path, error) from None
    _require_finite(path, model, said)
    return model


@contextmanager
def warnings_of_mujoco() -> Iterator[list[str]]:
    """A list of what MuJoCo warns of meanwhile, which is not logged."""
    said: list[str] = []
    mujoco.set_mju_user_warning(said.append)
    try:
        yield said
    finally:
        mujoco.set_mju_user_warning(logger.warning)


def _unloadable(path: str | Path, error: Exception) -> InputError:
    reason = " ".join(str(error).split()).rstrip(".")
    return InputError(f"{path} is no model that MuJoCo can load: {reason:.300}.")


def _require_affordable(path: Path) -> None:
    """Raises InputError before MuJoCo writes out more than `MOST_ELEMENTS`."""
    try:
        count = _elements(path, path.parent, {})
    except (ElementTree.ParseError, RecursionError, OSError, ValueError) as error:
        raise _unloadable(path, error) from None
    if count > MOST_ELEMENTS:
        raise InputError(
            f"{path} must have at most {MOST_ELEMENTS} elements, for MuJoCo writes them all out, "
            f"got {count:.3g} with the copies that {', '.join(COPYING)} make; lower their count."
        )


def _elements(path: Path, folder: Path, known: dict[Path, float]) -> float:
    """The elements of a file, with the copies that MuJoCo makes and the files that it reads.

    Files that are `known` were counted; one that is being counted, in a circle, counts as 0.
    """
    if path in known:
        return known[path]
    known[path] = 0.0
    root = ElementTree.parse(path).getroot()
    models = {model.get("name"): model.get("file") for model in root.iter("model")}

    def written(node: ElementTree.Element) -> float:
        other = {"include": node.get("file"), "attach": models.get(node.get("model"))}.get(node.tag)
        count = 1.0 + sum(map(written, node))
        if other and (folder / other).is_file():
            count += _elements(folder / other, folder, known)
        copies = node.get("count", "1") if node.tag in COPYING else "1"
        return count * math.prod(abs(float(word)) for word in copies.split())

    known[path] = written(root)
    return known[path]


def _require_finite(path: str | Path, model: mujoco.MjModel, said: Sequence[str]) -> None:
    """Raises InputError for a model that cannot be simulated; `said` are MuJoCo's warnings."""
    wrong = [line for line in said if "NaN" in line]
    infinite = (name for name in CONSTANTS if not np.isfinite(getattr(model, name)).all())
    wrong += [f"{name} is not finite." for name in infinite]
    if not 0.0 < model.opt.timestep < math.inf:
        wrong.append(f"timestep must be positive [s], got {model.opt.timestep:g}.")
    if wrong:
        raise InputError(f"{path} cannot be simulated: {' '.join(wrong)} Mend the number.")


def plant_of(path: str | Path) -> ChainPlant:
    """The plant of an MJCF file: an open chain of hinges and slides that motors or servos move.

    Columns of its recordings are `<joint>_position`, `<joint>_velocity` and `<actuator>`. Its
    parameters are `<body>_mass`, `<joint>_damping`, `<joint>_friction`, `<actuator>_gain`,
    `<actuator>_damping_time` (of a position servo: kv over kp, times gear) and `gravity`.

    Raises:
        InputError: the file is missing or no MJCF, or holds what such a chain cannot say: loops,
            tendons, free and ball joints, actuators with states, a fluid, limits of force that are
            not symmetric about 0, one name for several things; the message names it.
    """
    path = Path(path)
    model = load_mjcf(path, "--plant must be the id of an env or an MJCF file")
    return plant_of_model(model, path)


def faults_of(model: mujoco.MjModel) -> dict[str, int]:
    """How often a model has what the equations of a plant have not."""
    return _faults(model) | _faults_of_actuators(model)


def plant_of_model(model: mujoco.MjModel, path: Path) -> ChainPlant:
    """The plant of a model that was loaded already, see `plant_of`."""
    _require(str(path), faults_of(model))
    if model.nv == 0 or model.nu == 0:
        raise InputError(f"{path} must have joints and motors, got {model.nv} and {model.nu}.")
    chain = _chain(model)
    layout = _layout(model, chain)
    require_names(layout, path)
    parameters, base = _nominal(model, layout)
    masses = {body.name: body.mass for body in chain.bodies}

    def build(p: Mapping[str, float]) -> Chain:
        bodies = []
        for body in chain.bodies:
            mass = p.get(f"{body.name}_mass", body.mass)
            factor = mass / masses[body.name] if masses[body.name] > 0.0 else 1.0
            inertia = _rows(factor * np.array(body.inertia))
            bodies.append(replace(body, mass=mass, inertia=inertia))
        down = np.array(model.opt.gravity)
        size = np.linalg.norm(down)
        gravity = p["gravity"] * down / size if size > 0.0 else down
        return Chain(tuple(bodies), _vector(gravity))

    return ChainPlant(
        name=path.stem,
        layout=layout,
        parameters=parameters,
        build=build,
        base=base,
        masses={body: f"{body}_mass" for body in layout.bodies if masses[body] > 0.0},
        angles=tuple(2 * j for j, slides in enumerate(layout.slides) if not slides),
        file_timestep_s=float(model.opt.timestep),
        integrator=_integrator(model),
    )


def _integrator(model: mujoco.MjModel) -> FirstOrder | None:
    """MuJoCo's, but for Runge and Kutta's, whose error is far below the first order.

    Euler's takes the damping of joints at the end of a step and that of servos at its beginning.

    Reference: MuJoCo documentation, Computation, "Numerical integration".
    """
    h, kind = float(model.opt.timestep), mujoco.mjtIntegrator(model.opt.integrator)
    if kind == mujoco.mjtIntegrator.mjINT_RK4:
        return None
    euler = kind == mujoco.mjtIntegrator.mjINT_EULER
    late = not euler or not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    inertia = np.where(late, 0.5, -0.5) * h * model.dof_damping
    for u, (j, _) in enumerate(model.actuator_trnid):
        damping = -model.actuator_biasprm[u, 2] * model.actuator_gear[u, 0] ** 2
        inertia[model.jnt_dofadr[j]] += (-0.5 if euler else 0.5) * h * damping
    return FirstOrder(h, tuple(inertia.tolist()))


def chain_of(model: mujoco.MjModel) -> Chain:
    """The bodies of a MuJoCo model, those without a joint joined to their parents.

    Actuators, friction, springs and contacts are no part of it.

    Raises:
        InputError: the model has what such a chain cannot say: loops, tendons, free and ball
            joints, a fluid; the message names it.
    """
    _require("the model", _faults(model))
    if model.nv == 0:
        raise InputError("the model must have joints, got none.")
    return _chain(model)


def _require(what: str, faults: Mapping[str, int]) -> None:
    found = [f"{count} {name}" for name, count in faults.items() if count]
    if found:
        raise InputError(
            f"{what} must be an open chain of hinges and slides that motors or servos move, got "
            f"{', '.join(found)}; take these out of the model."
        )


def _count(model: mujoco.MjModel, name: str, usual: int = 0) -> int:
    """Rows of an array in which something is not as usual; older models lack some arrays."""
    array = np.asarray(getattr(model, name, [])) != usual
    return int(array.any(axis=tuple(range(1, array.ndim))).sum())


def _faults(model: mujoco.MjModel) -> dict[str, int]:
    """How often the model has what a chain has not."""
    fluid = model.opt.density or model.opt.viscosity
    return {
        "equality constraints": model.neq,
        "tendons": model.ntendon,
        "flexible bodies": getattr(model, "nflex", 0),
        "plugins": getattr(model, "nplugin", 0),
        "free or ball joints": int((model.jnt_type < int(mujoco.mjtJoint.mjJNT_SLIDE)).sum()),
        "joints with polynomial damping": _count(model, "dof_dampingpoly"),
        "joints with polynomial stiffness": _count(model, "jnt_stiffnesspoly"),
        "bodies without their weight (gravcomp)": _count(model, "body_gravcomp"),
        "fluids": int(bool(fluid)),
        "options that switch forces off": (model.opt.disableflags & SWITCHES).bit_count(),
    }


def _faults_of_actuators(model: mujoco.MjModel) -> dict[str, int]:
    """How often the model has what a plant's motors have not."""
    count = partial(_count, model)
    return {
        "actuators without a joint": count("actuator_trntype", int(mujoco.mjtTrn.mjTRN_JOINT)),
        "muscles and other actuators whose force is no affine function of the command": sum(
            max(model.actuator_gaintype[u], model.actuator_biastype[u]) > 1
            or not model.actuator_gear[u, 0] * model.actuator_gainprm[u, 0]
            for u in range(model.nu)
        ),
        "actuators with states": count("actuator_dyntype", int(mujoco.mjtDyn.mjDYN_NONE)),
        "actuators with damping": count("actuator_damping"),
        "actuators with armature": count("actuator_armature"),
        "actuators with a delay": count("actuator_delay"),
        "ranges of forces that are not symmetric about 0": sum(
            int(abs(low + high) > 1e-9 * abs(high - low)) for _, (low, high) in _ranges(model)
        ),
        "joints that limit what several motors do together": sum(
            int(model.jnt_actfrclimited[j] and (model.actuator_trnid[:, 0] == j).sum() > 1)
            for j in range(model.njnt)
        ),
    }


def _ranges(model: mujoco.MjModel) -> Iterator[tuple[int, np.ndarray]]:
    """The actuators that have limits, with each of these: of their force, and their joint's."""
    for u in range(model.nu):
        if model.actuator_forcelimited[u]:
            yield u, model.actuator_forcerange[u]
        if model.jnt_actfrclimited[model.actuator_trnid[u, 0]]:
            yield u, model.jnt_actfrcrange[model.actuator_trnid[u, 0]]


def _chain(model: mujoco.MjModel) -> Chain:
    """Its bodies, those without a joint joined to their parents."""
    bodies: list[Body] = []
    frames: list[tuple[int, np.ndarray, np.ndarray]] = [(-1, np.zeros(3), np.eye(3))]
    """of each body: what it moves with, and where its frame is in that one's"""
    loads: dict[int, list[tuple[float, np.ndarray, np.ndarray]]] = {}
    for b in range(1, model.nbody):
        parent, p0, R0 = frames[model.body_parentid[b]]
        origin = p0 + R0 @ model.body_pos[b]
        R = R0 @ matrix_of(model.body_quat[b])
        name = model.body(b).name or f"body{b}"
        joints = range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b])
        for count, j in enumerate(joints):
            anchor = np.array(model.jnt_pos[j])
            slides = model.jnt_type[j] == int(mujoco.mjtJoint.mjJNT_SLIDE)
            joint = model.joint(j).name or f"joint{j}"
            last = count == len(joints) - 1
            bodies.append(
                Body(
                    name=name if last else f"{name}_{joint}",
                    joint=joint,
                    kind=SLIDE if slides else HINGE,
                    axis=_vector(model.jnt_axis[j]),
                    mass=0.0,
                    parent=parent,
                    origin=_vector(origin + R @ anchor),
                    rotation=_rows(R),
                    armature=float(model.dof_armature[model.jnt_dofadr[j]]),
                )
            )
            parent, origin, R = len(bodies) - 1, -anchor, np.eye(3)
        frames.append((parent, origin, R))
        Ri = matrix_of(model.body_iquat[b])
        inertia = R @ Ri @ np.diag(model.body_inertia[b]) @ Ri.T @ R.T
        load = (float(model.body_mass[b]), origin + R @ model.body_ipos[b], inertia)
        loads.setdefault(parent, []).append(load)
    loaded = tuple(_loaded(body, loads.get(n, [])) for n, body in enumerate(bodies))
    return Chain(loaded, _vector(model.opt.gravity))


def _loaded(body: Body, loads: list[tuple[float, np.ndarray, np.ndarray]]) -> Body:
    """A body with the masses that move with it."""
    mass = sum(m for m, _, _ in loads)
    if mass == 0.0:
        return body
    center = np.sum([m * c for m, c, _ in loads], axis=0) / mass
    inertia = np.sum([own + m * _about(c - center) for m, c, own in loads], axis=0)
    return replace(body, mass=mass, center=_vector(center), inertia=_rows(inertia))


def _about(d: np.ndarray) -> np.ndarray:
    """Inertia of a unit of mass at d, about the origin [m^2]: Steiner's theorem."""
    return d @ d * np.eye(3) - np.outer(d, d)


def _layout(model: mujoco.MjModel, chain: Chain) -> Layout:
    joints, drives = chain.joints, tuple(int(j) for j in model.actuator_trnid[:, 0])
    slides = tuple(body.kind == SLIDE for body in chain.bodies)
    return Layout(
        joints=joints,
        slides=slides,
        bodies=tuple(body.name for body in chain.bodies),
        states=tuple(f"{joint}_{what}" for joint in joints for what in ("position", "velocity")),
        inputs=tuple(model.actuator(u).name or f"actuator{u}" for u in range(model.nu)),
        drives=drives,
        targets=tuple(unit_of_target(model, u, slides[j]) for u, j in enumerate(drives)),
    )


def asks_for_force(model: mujoco.MjModel, u: int) -> bool:
    """Whether the command of an actuator is a force, or a part of one."""
    fixed = int(model.actuator_gaintype[u]) == int(mujoco.mjtGain.mjGAIN_FIXED)
    return fixed and int(model.actuator_biastype[u]) == int(mujoco.mjtBias.mjBIAS_NONE)


def unit_of_target(model: mujoco.MjModel, u: int, slides: bool) -> str:
    """The unit of a servo's target; empty where an actuator asks for a force."""
    if asks_for_force(model, u):
        return ""
    if int(model.actuator_gaintype[u]) > 1:
        return "-"  # how far a muscle is excited
    position = "m" if slides else "rad"
    follows = model.actuator_biasprm[u, 1] != 0.0
    return position if follows else f"{position}/s"


def require_names(layout: Layout, path: str | Path) -> None:
    """Raises InputError where a name stands for things at several joints, or for two columns."""
    joints = range(len(layout.joints))
    owners = [
        *zip(layout.joints, joints, strict=True),
        *(() if layout.carriers else zip(layout.bodies, joints, strict=True)),
        *zip(layout.actuators, layout.drives, strict=True),
        *((state, x // 2) for x, state in enumerate(layout.states)),
    ]
    names = sorted({name for name, _ in owners})
    doubtful = [name for name in names if len({at for own, at in owners if own == name}) > 1]
    doubtful += [name for name in layout.inputs if name in layout.states]
    if doubtful:
        raise InputError(
            f"{path} must give a body, its joint and its motor names that no other joint's have, "
            f"got {', '.join(doubtful)} at several; rename them."
        )


def _nominal(
    model: mujoco.MjModel, layout: Layout
) -> tuple[tuple[Parameter, ...], tuple[Base, ...]]:
    """Its parameters, and the effects that the model has already."""
    parameters = [
        Parameter(f"{body.name}_mass", body.mass, "kg", low=1e-9)
        for body in _chain(model).bodies
        if body.mass > 0.0
    ]
    base: list[Base] = []

    def has(effect: str, target: str, *values: float | str) -> None:
        base.append(Base(EffectInstance(CATALOGUE[effect], target), values))

    for j, joint in enumerate(layout.joints):
        dof = model.jnt_dofadr[j]
        position, force = layout.unit_of(joint)
        damping, dry = float(model.dof_damping[dof]), float(model.dof_frictionloss[dof])
        if damping > 0.0:
            parameters.append(Parameter(f"{joint}_damping", damping, f"{force} s/{position}"))
            has("viscous_friction", joint, f"{joint}_damping")
        if dry > 0.0:
            parameters.append(Parameter(f"{joint}_friction", dry, force))
            soft = creep(model, dof) or TURN_OVER, foresight(model, dof)
            base.append(Base(EffectInstance(SoftFriction(), joint), (f"{joint}_friction", *soft)))
        stiffness = float(model.jnt_stiffness[j])
        if stiffness > 0.0:
            rest = float(model.qpos_spring[model.jnt_qposadr[j]])
            has("spring", joint, stiffness)
            if rest:
                has("constant_force", joint, stiffness * rest)
    for u, name in enumerate(layout.inputs):
        target = layout.actuator(u)
        gain = float(model.actuator_gear[u, 0] * model.actuator_gainprm[u, 0])
        parameters.append(Parameter(f"{name}_gain", gain, "-", low=-np.inf))
        if model.actuator_ctrllimited[u]:
            low, high = map(float, model.actuator_ctrlrange[u])
            about = 0.5 * (high - low), 0.5 * (high + low)
            base.append(Base(EffectInstance(CommandRange(), target), about))
        if target in layout.servos:
            gear, (b_0, b_1, b_2) = model.actuator_gear[u, 0], model.actuator_biasprm[u, :3]
            feedback = (-gear * gear * b_1, -gear * gear * b_2, gear * b_0)
            k, d, b_0 = (float(number / gain) for number in feedback)
            time, follows = f"{name}_{DAMPING_TIME}", bool(k and d)
            if follows:  # a position; the damping of a velocity servo is its gain
                parameters.append(Parameter(time, d, "s", low=-np.inf))
            base.append(Base(EffectInstance(Servo(), target), (k, time if follows else d, b_0)))
        if model.actuator_forcelimited[u]:
            most = float(np.abs(model.actuator_gear[u, 0]) * model.actuator_forcerange[u, 1])
            has("actuator_saturation", target, most)
        if model.jnt_actfrclimited[layout.drives[u]]:
            most = float(model.jnt_actfrcrange[layout.drives[u], 1])
            has("actuator_saturation", target, most)
        has("actuator_gain", target, f"{name}_gain")
    size = float(np.linalg.norm(model.opt.gravity))
    parameters.append(Parameter("gravity", size, "m/s^2", uncertain=False))
    return tuple(parameters), tuple(base)


def creep(model: mujoco.MjModel, dof: int) -> float:
    """Speed up to which MuJoCo's own dry friction in a joint is soft [m/s or rad/s].

    Under a part of the force f that lets go a joint at rest creeps with this part of f R / b, by
    the regularisation R and the damping b of its constraint. Where little moves with the joint that
    is much: 0.08 rad/s in a UR5e's last one, at 0.01 N m.

    Reference: MuJoCo documentation, Computation, "Solver parameters", with r = 0 and at rest.
    """
    d = np.clip(model.dof_solimp[dof, 0], mujoco.mjMINIMP, mujoco.mjMAXIMP)
    R = (1.0 - d) / d * model.dof_invweight0[dof]
    return float(model.dof_frictionloss[dof] * R * foresight(model, dof))


def foresight(model: mujoco.MjModel, dof: int) -> float:
    """How far ahead MuJoCo's own dry friction in a joint sees the velocity [s].

    It is 1 / b, by the damping b of its constraint, and 9.5 ms where a model says nothing else; 0
    where a constraint is not damped.
    """
    solref, most = model.dof_solref[dof], model.dof_solimp[dof, 1]
    d_max = np.clip(most, mujoco.mjMINIMP, mujoco.mjMAXIMP)
    if solref[0] <= 0.0:
        return float(d_max / -solref[1]) if solref[1] < 0.0 else 0.0
    safe = not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_REFSAFE)
    return float(0.5 * d_max * max(solref[0], 2.0 * model.opt.timestep if safe else 0.0))


def _vector(array: np.ndarray) -> Vector:
    x, y, z = map(float, array)
    return x, y, z


def _rows(array: np.ndarray) -> Matrix:
    x, y, z = map(_vector, array)
    return x, y, z
