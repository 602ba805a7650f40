"""A MuJoCo model as a plant, by whichever kind can say it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np

from mcpilco.mjcf.inertials import Inertials
from mcpilco.mjcf.models import (
    asks_for_force,
    faults_of,
    load_mjcf,
    plant_of_model,
    require_names,
    unit_of_target,
)
from mcpilco.mjcf.mujoco.coordinates import Coordinates, states
from mcpilco.mjcf.mujoco.plant import MujocoPlant
from mcpilco.plant import Layout, Parameter, Plant
from mcpilco.typing import InputError

Physics = Literal["auto", "equations", "mujoco"]
"""who simulates a model: `auto` takes equations where they can say it"""

_AXES = ("x", "y", "z"), ("rx", "ry", "rz")
_BALL, _SLIDE = int(mujoco.mjtJoint.mjJNT_BALL), int(mujoco.mjtJoint.mjJNT_SLIDE)
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)


def read_plant(path: str | Path, physics: Physics = "auto", keyframe: str = "") -> Plant:
    """The plant of an MJCF or URDF file.

    Equations say an open chain of hinges and slides, on motors or servos, that stands on nothing;
    all else MuJoCo simulates itself. Of a free joint `<joint>_x_position` to
    `<joint>_rz_velocity` are the columns, see `Layout`. Whether a recorded machine touches what it
    could touch, or where its joints end, `spans_touching` tells.

    Args:
        path: of the file.
        physics: who simulates it.
        keyframe: the name of the pose of states that recordings do not tell; empty: that in which
            the model is drawn.

    Raises:
        InputError: MuJoCo cannot load the file, it has no joints, no such keyframe, or equations
            are asked for and cannot say it.
    """
    path = Path(path)
    model = load_mjcf(path, "--plant must be the id of an env, an MJCF or a URDF file")
    sayable = model.nu and not any(faults_of(model).values()) and not _grounded(model)
    if physics == "equations" or (physics == "auto" and sayable and not keyframe):
        return plant_of_model(model, path)
    return mujoco_plant(model, path.stem, keyframe)


def mujoco_plant(model: mujoco.MjModel, name: str, keyframe: str = "") -> MujocoPlant:
    """A model that MuJoCo simulates; `name` is for reports.

    Raises:
        InputError: it has no joints, no such keyframe, one name for several things, or actuators
            of several commands.
    """
    if model.nv == 0:
        raise InputError(f"{name} must have joints, got none.")
    if model.nu != len(model.actuator_trnid) or model.nplugin:
        raise InputError(f"{name} must have actuators of one command each, and no plugins.")
    layout = _layout(model)
    require_names(layout, name)
    inertials = Inertials(model)
    parameters = tuple(_parameters(model, layout, inertials))
    return MujocoPlant(
        name,
        layout,
        parameters,
        model,
        {parameter.name: parameter.value for parameter in parameters},
        np.array([_strength(model, u) for u in range(model.nu)]),
        start=_pose(model, name, keyframe),
        masses={body: f"{body}_mass" for body in layout.bodies},
        angles=tuple(2 * layout.joints.index(hinge) for hinge in layout.hinges),
    )


def _pose(model: mujoco.MjModel, name: str, keyframe: str) -> np.ndarray:
    qpos, qvel = model.qpos0, np.zeros(model.nv)
    if keyframe:
        names = [model.key(k).name for k in range(model.nkey)]
        if keyframe not in names:
            told = ", ".join(filter(None, names)) or "none that has a name"
            raise InputError(f"{name} has no keyframe {keyframe!r}; it has {told}.")
        qpos, qvel = (getattr(model, f"key_{q}")[names.index(keyframe)] for q in ("qpos", "qvel"))
    return states(Coordinates.of(model).positions(qpos), qvel)


def _grounded(model: mujoco.MjModel) -> bool:
    """Whether something that never moves can touch something that does."""
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CONTACT):
        return False
    fixed = model.body_weldid[model.geom_bodyid] == 0
    kinds, with_ = model.geom_contype, model.geom_conaffinity
    touch = (kinds[:, None] & with_) | (with_[:, None] & kinds)
    paired = any(
        fixed[a] != fixed[b] for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)
    )
    return bool((touch[np.ix_(fixed, ~fixed)] != 0).any()) or paired


def _touches(model: mujoco.MjModel) -> bool:
    off = model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    collides = ((model.geom_contype != 0) & (model.geom_conaffinity != 0)).any()
    return bool(not off and (_grounded(model) or collides or model.npair))


def _layout(model: mujoco.MjModel) -> Layout:
    joints: list[str] = []
    slides: list[bool] = []
    floating: list[int] = []
    orientations: list[int] = []
    for j in range(model.njnt):
        name, kind = model.joint(j).name or f"joint{j}", int(model.jnt_type[j])
        if kind in (_FREE, _BALL):
            first, axes = len(joints), _AXES if kind == _FREE else (_AXES[1],)
            joints += [f"{name}_{axis}" for group in axes for axis in group]
            slides += [group is _AXES[0] for group in axes for _ in group]
            floating += range(first, len(joints))
            orientations.append(len(joints) - 3)
        else:
            joints.append(name)
            slides.append(kind == _SLIDE)
    moved = [b for b in range(1, model.nbody) if model.body_jntnum[b] and model.body_mass[b] > 0.0]
    inputs = tuple(model.actuator(u).name or f"actuator{u}" for u in range(model.nu))
    drives = _drives(model)
    units = [unit_of_target(model, u, slides[j]) for u, j in enumerate(drives)]
    bodies = [model.body(b).name or f"body{b}" for b in moved]
    return Layout(
        joints=tuple(joints),
        slides=tuple(slides),
        bodies=tuple(bodies),
        states=tuple(f"{joint}_{what}" for joint in joints for what in ("position", "velocity")),
        inputs=inputs,
        drives=drives,
        carriers=tuple(int(model.body_dofadr[b] + model.body_dofnum[b] - 1) for b in moved),
        floating=(*floating, *_planar_base(model, drives)),
        orientations=tuple(orientations),
        targets=tuple(units),
        contacts=("ground",) if _touches(model) else (),
    )


def _planar_base(model: mujoco.MjModel, drives: tuple[int, ...]) -> Iterator[int]:
    """Degrees of freedom of bodies that stand on nothing: bearings that no machine has."""
    for b in range(1, model.nbody):
        first, count = model.body_dofadr[b], model.body_dofnum[b]
        own = range(first, first + count)
        held = (
            model.dof_damping[own].any() or model.dof_frictionloss[own].any() or {*own} & {*drives}
        )
        springs = model.jnt_stiffness[model.body_jntadr[b] :][: model.body_jntnum[b]].any()
        if model.body_parentid[b] == 0 and model.body_jntnum[b] > 1 and not (held or springs):
            yield from own


def _drives(model: mujoco.MjModel) -> tuple[int, ...]:
    """The degree of freedom that each actuator moves most."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found = []
    for u in range(model.nu):
        row = slice(data.moment_rowadr[u], data.moment_rowadr[u] + data.moment_rownnz[u])
        moments = np.abs(data.actuator_moment[row])
        found.append(int(data.moment_colind[row][moments.argmax()]) if moments.any() else 0)
    return tuple(found)


def _strength(model: mujoco.MjModel, u: int) -> float:
    force = float(model.actuator_gear[u, 0] * model.actuator_gainprm[u, 0])
    return force if force and asks_for_force(model, u) else 1.0


def _parameters(model: mujoco.MjModel, layout: Layout, inertials: Inertials) -> Iterator[Parameter]:
    for body in layout.bodies:
        yield Parameter(f"{body}_mass", inertials.mass_and_arm(body)[0], "kg", low=1e-9)
    for joint in layout.guided:
        dof = layout.joints.index(joint)
        position, force = layout.unit_of(joint)
        damping, dry = float(model.dof_damping[dof]), float(model.dof_frictionloss[dof])
        if damping > 0.0:
            yield Parameter(f"{joint}_damping", damping, f"{force} s/{position}")
        if dry > 0.0:
            yield Parameter(f"{joint}_friction", dry, force)
    for u, name in enumerate(layout.inputs):
        gain = float(model.actuator_gear[u, 0] * model.actuator_gainprm[u, 0])
        if gain and int(model.actuator_gaintype[u]) <= 1 and int(model.actuator_biastype[u]) <= 1:
            yield Parameter(f"{name}_gain", gain, "-", low=-np.inf)
    size = float(np.linalg.norm(model.opt.gravity))
    yield Parameter("gravity", size, "m/s^2", uncertain=False)
