"""A MuJoCo model as a plant: the same equations, with names for recordings and nominal effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from mcpilco.effects import CATALOGUE
from mcpilco.mechanics import HINGE, SLIDE, Body, Chain
from mcpilco.plant import Active, Base, Parameter, Plant
from mcpilco.simulation import Layout
from mcpilco.typing import InputError

TURN_OVER = 2e-3
"""velocity over which the model's dry friction turns over [m/s or rad/s]"""


def plant_of(path: str | Path) -> Plant:
    """The plant of an MJCF file: an open chain of hinges and slides that motors move.

    Columns of its recordings are `<joint>_position`, `<joint>_velocity` and `<actuator>`. Its
    parameters are `<body>_mass`, `<joint>_damping`, `<joint>_friction`, `<actuator>_gain` and
    `gravity`.

    Raises:
        InputError: the file is missing or no MJCF, or holds what a chain cannot say: loops, tendons,
            free and ball joints, actuators that are no motors.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"--plant must be the id of an env or an MJCF file, got {str(path)!r}.")
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise InputError(f"{path} is no model that MuJoCo can load: {error}") from None
    _require_chain(model, path)
    chain = _chain(model)
    layout = _layout(model, chain)
    parameters, base = _nominal(model, layout)
    masses = {body.name: body.mass for body in chain.bodies}

    def build(p: Mapping[str, float]) -> Chain:
        bodies = []
        for body in chain.bodies:
            mass = p.get(f"{body.name}_mass", body.mass)
            factor = mass / masses[body.name] if masses[body.name] > 0.0 else 1.0
            inertia = tuple(tuple(factor * x for x in row) for row in body.inertia)
            bodies.append(replace(body, mass=mass, inertia=inertia))
        down = np.array(model.opt.gravity)
        size = np.linalg.norm(down)
        gravity = tuple(p["gravity"] * down / size) if size > 0.0 else (0.0, 0.0, 0.0)
        return Chain(tuple(bodies), gravity)

    return Plant(
        name=path.stem,
        layout=layout,
        parameters=parameters,
        build=build,
        base=base,
        masses={body: f"{body}_mass" for body in layout.bodies if masses[body] > 0.0},
        angles=tuple(2 * j for j, slides in enumerate(layout.slides) if not slides),
    )


def _require_chain(model: mujoco.MjModel, path: Path) -> None:
    faults = [
        (model.neq, "equality constraints"),
        (model.ntendon, "tendons"),
        (int((model.jnt_type < int(mujoco.mjtJoint.mjJNT_SLIDE)).sum()), "free or ball joints"),
        (int((model.actuator_trntype != int(mujoco.mjtTrn.mjTRN_JOINT)).sum()), "actuators without a joint"),
        (int((model.actuator_biastype != int(mujoco.mjtBias.mjBIAS_NONE)).sum()), "servo actuators"),
    ]
    found = [f"{count} {name}" for count, name in faults if count]
    if found:
        raise InputError(
            f"{path} must be an open chain of hinges and slides that motors move, got "
            f"{', '.join(found)}; take these out of the model."
        )
    if model.nv == 0 or model.nu == 0:
        raise InputError(f"{path} must have joints and motors, got {model.nv} and {model.nu}.")


def _chain(model: mujoco.MjModel) -> Chain:
    """Its bodies, those without a joint joined to their parents."""
    bodies: list[Body] = []
    frames: list[tuple[int, np.ndarray, np.ndarray]] = [(-1, np.zeros(3), np.eye(3))]
    """of each body: what it moves with, and where its frame is in that one's"""
    loads: dict[int, list[tuple[float, np.ndarray, np.ndarray]]] = {}
    for b in range(1, model.nbody):
        parent, p0, R0 = frames[model.body_parentid[b]]
        origin = p0 + R0 @ model.body_pos[b]
        R = R0 @ _matrix(model.body_quat[b])
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
                    axis=tuple(float(x) for x in model.jnt_axis[j]),
                    mass=0.0,
                    parent=parent,
                    origin=tuple(float(x) for x in origin + R @ anchor),
                    rotation=tuple(tuple(float(x) for x in row) for row in R),
                    armature=float(model.dof_armature[model.jnt_dofadr[j]]),
                )
            )
            parent, origin, R = len(bodies) - 1, -anchor, np.eye(3)
        frames.append((parent, origin, R))
        Ri = _matrix(model.body_iquat[b])
        inertia = R @ Ri @ np.diag(model.body_inertia[b]) @ Ri.T @ R.T
        load = (float(model.body_mass[b]), origin + R @ model.body_ipos[b], inertia)
        loads.setdefault(parent, []).append(load)
    return Chain(tuple(_loaded(body, loads.get(n, [])) for n, body in enumerate(bodies)))


def _loaded(body: Body, loads: list[tuple[float, np.ndarray, np.ndarray]]) -> Body:
    """A body with the masses that move with it."""
    mass = sum(m for m, _, _ in loads)
    if mass == 0.0:
        return body
    center = sum(m * c for m, c, _ in loads) / mass
    inertia = sum(
        I + m * ((c - center) @ (c - center) * np.eye(3) - np.outer(c - center, c - center))
        for m, c, I in loads
    )
    return replace(
        body,
        mass=mass,
        center=tuple(float(x) for x in center),
        inertia=tuple(tuple(float(x) for x in row) for row in inertia),
    )


def _layout(model: mujoco.MjModel, chain: Chain) -> Layout:
    joints = chain.joints
    return Layout(
        joints=joints,
        slides=tuple(body.kind == SLIDE for body in chain.bodies),
        bodies=tuple(body.name for body in chain.bodies),
        states=tuple(f"{joint}_{what}" for joint in joints for what in ("position", "velocity")),
        inputs=tuple(model.actuator(u).name or f"actuator{u}" for u in range(model.nu)),
        drives=tuple(int(model.actuator_trnid[u, 0]) for u in range(model.nu)),
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
    base = []
    for j, joint in enumerate(layout.joints):
        dof = model.jnt_dofadr[j]
        position, force = layout.unit_of(joint)
        damping, dry = float(model.dof_damping[dof]), float(model.dof_frictionloss[dof])
        if damping > 0.0:
            parameters.append(Parameter(f"{joint}_damping", damping, f"{force} s/{position}"))
            base.append(Base(Active(CATALOGUE["viscous_friction"], joint), (f"{joint}_damping",)))
        if dry > 0.0:
            parameters.append(Parameter(f"{joint}_friction", dry, force))
            names = (f"{joint}_friction", TURN_OVER)
            base.append(Base(Active(CATALOGUE["coulomb_friction"], joint), names))
        stiffness = float(model.jnt_stiffness[j])
        if stiffness > 0.0:
            rest = float(model.qpos_spring[model.jnt_qposadr[j]])
            base.append(Base(Active(CATALOGUE["spring"], joint), (stiffness,)))
            if rest:
                push = (stiffness * rest,)
                base.append(Base(Active(CATALOGUE["constant_force"], joint), push))
    for u, name in enumerate(layout.inputs):
        target = layout.actuator(u)
        gain = float(model.actuator_gear[u, 0] * model.actuator_gainprm[u, 0])
        parameters.append(Parameter(f"{name}_gain", gain, "-", low=-np.inf))
        if model.actuator_ctrllimited[u]:
            limit = abs(gain) * float(np.abs(model.actuator_ctrlrange[u]).max())
            base.append(Base(Active(CATALOGUE["actuator_saturation"], target), (limit,)))
        base.append(Base(Active(CATALOGUE["actuator_gain"], target), (f"{name}_gain",)))
    size = float(np.linalg.norm(model.opt.gravity))
    parameters.append(Parameter("gravity", size, "m/s^2", uncertain=False))
    return tuple(parameters), tuple(base)


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)
