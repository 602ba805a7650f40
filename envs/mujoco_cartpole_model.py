"""The MuJoCo model of a cart-pole: ours with other numbers, or one that a user gives."""

from __future__ import annotations

import os
from pathlib import Path

import mujoco
import numpy as np

from mcpilco.mjcf import load_mjcf
from mcpilco.plant import ChainPlant
from mcpilco.typing import InputError

BUILT_IN = Path(__file__).parent / "assets" / "cartpole.xml"
"""PILCO's cart-pole as MJCF; a model of one's own best begins as a copy of it"""

JOINTS = {"cart": mujoco.mjtJoint.mjJNT_SLIDE, "pole": mujoco.mjtJoint.mjJNT_HINGE}
"""name -> kind of the joints that a model must have, in the order of the state"""
CONSTANTS = "cart_mass", "pole_mass", "pole_length", "cart_friction", "gravity"
"""parameters of the plant `envs.plants.cart_pole` that the built-in model takes"""
ACTUATOR = "force"
"""name of the actuator that a model must have"""


def build_model(plant: ChainPlant) -> mujoco.MjModel:
    """The built-in model with the constants of a cart-pole's plant."""
    spec = mujoco.MjSpec.from_file(str(BUILT_IN))
    cart_mass, pole_mass, length, friction, gravity = (plant.values[name] for name in CONSTANTS)
    _resize(spec, length / -spec.site("tip").pos[2])
    cart, pole = spec.body("cart"), spec.body("pole")
    cart.mass, pole.mass = cart_mass, pole_mass
    middle = pole_mass * length**2 / 12.0
    # MuJoCo wants three moments of inertia; the last, about the pole itself, moves nothing
    pole.inertia = [middle, middle, 1e-3 * middle]
    spec.option.gravity = [0.0, 0.0, -gravity]
    model = spec.compile()
    model.dof_damping[model.joint("cart").dofadr] = friction
    return model


def read_model(path: str | os.PathLike[str]) -> mujoco.MjModel:
    """The model in a file of MJCF."""
    if not isinstance(path, str | os.PathLike):
        raise InputError(f"model must be the path of an MJCF file, got {path!r}.")
    model = load_mjcf(os.fspath(path), "model must be an MJCF file")
    try:
        _check(model)
    except InputError as error:
        raise InputError(
            f"model {os.fspath(path)!r}: {error} {BUILT_IN} is a model to begin with."
        ) from None
    return model


def input_limit(model: mujoco.MjModel) -> float:
    """The largest force that the model's actuator takes [N]."""
    actuator = model.actuator(ACTUATOR)
    low, high = actuator.ctrlrange
    if not actuator.ctrllimited or low != -high or high <= 0:
        raise InputError(
            f'force_limit must be given, because the actuator "{ACTUATOR}" of the model has no '
            "ctrlrange from -limit to limit."
        )
    return float(high)


def _resize(spec: mujoco.MjSpec, factor: float) -> None:
    """Makes all lengths that are drawn, and the pole's centre of mass, so many times as large."""
    for shape in (*spec.geoms, *spec.sites):
        shape.pos, shape.size = factor * shape.pos, factor * shape.size
        shape.fromto = factor * shape.fromto
    for body in spec.bodies:
        body.ipos = factor * body.ipos


def _check(model: mujoco.MjModel) -> None:
    """Raises InputError unless the model is a cart-pole."""
    for name, kind in JOINTS.items():
        _require_kind(model, name, kind)
    names = [model.joint(i).name or "(no name)" for i in range(model.njnt)]
    _require(
        model.njnt == len(JOINTS),
        f'a cart-pole has the joints "cart" and "pole" only, got {", ".join(names)}.',
    )
    _check_actuator(model)
    further = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS) - 5
    _require(
        further == 0,
        f"positions and velocities must be the whole state, but it has {further} numbers more, "
        "as activations of actuators or plugins; remove them.",
    )
    _require(
        _rises(model),
        "the pole must hang at the angle 0, but there it is higher than half a turn further; "
        "turn its body.",
    )


def _require_kind(model: mujoco.MjModel, name: str, kind: mujoco.mjtJoint) -> None:
    """Raises InputError unless there is a joint of this name and kind."""
    word = kind.name.removeprefix("mjJNT_").lower()
    i = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
    _require(
        i >= 0, f'it has no joint "{name}"; the {word} joint of the {name} must have this name.'
    )
    got = mujoco.mjtJoint(model.jnt_type[i]).name.removeprefix("mjJNT_").lower()
    _require(got == word, f'the joint "{name}" must be of type {word}, got {got}.')


def _check_actuator(model: mujoco.MjModel) -> None:
    """Raises InputError unless there is one actuator, whose control is the force on the cart."""
    i = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, ACTUATOR)
    _require(
        i >= 0,
        f'it has no actuator "{ACTUATOR}"; add <motor name="{ACTUATOR}" joint="cart" '
        'ctrlrange="-10 10"/>.',
    )
    _require(model.nu == 1, f'it must have no actuator but "{ACTUATOR}", got {model.nu}.')
    cart = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, "cart")
    on_cart = model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
    _require(
        on_cart and model.actuator_trnid[i, 0] == cart,
        f'the actuator "{ACTUATOR}" must act on the joint "cart".',
    )
    plain = (
        model.actuator_gaintype[i] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_NONE
        and model.actuator_dyntype[i] == mujoco.mjtDyn.mjDYN_NONE
        and np.isclose(model.actuator_gainprm[i, 0] * model.actuator_gear[i, 0], 1.0)
    )
    _require(
        bool(plain),
        f'the control of the actuator "{ACTUATOR}" must be the force on the cart in N: a motor '
        "with gear 1.",
    )


def _rises(model: mujoco.MjModel) -> bool:
    """Whether the pole is higher at half a turn than at 0, or nothing pulls it down."""
    data = mujoco.MjData(model)
    joint = model.joint("pole")
    heights = []
    for angle in (0.0, np.pi):
        data.qpos[joint.qposadr] = angle
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        heights.append(-model.opt.gravity @ data.subtree_com[joint.bodyid[0]])
    return bool(heights[1] >= heights[0])


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise InputError(message)
