"""Chains of bodies as MJCF, and the plant of an MJCF that a file of another kind holds."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from mcpilco.bodies import SLIDE, Chain
from mcpilco.files import write_bytes
from mcpilco.mjcf.models import load_mjcf, plant_of
from mcpilco.plant import ChainPlant

LEAST_INERTIA = 1e-10
"""principal moment that MuJoCo wants at least of a body that moves [kg m^2]"""
SMALLEST = 1e-6
"""mass that it wants at least [kg]"""


def mjcf_of(chain: Chain, motors: Sequence[tuple[str, int, float]]) -> str:
    """The MJCF of a chain: bodies with their inertias, joints, and a motor for each input.

    Args:
        chain: joints, frames, masses and gravity.
        motors: of each input its name, the number of the joint that it drives, and its gain.
    """
    spec = mujoco.MjSpec()
    spec.option.gravity = chain.gravity
    bodies = [spec.worldbody]
    for link in chain.bodies:
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, np.ravel(link.rotation))
        body = bodies[link.parent + 1].add_body(name=link.name, pos=link.origin, quat=quat)
        values, axes = np.linalg.eigh(np.array(link.inertia))
        inertia = (axes * np.maximum(values, LEAST_INERTIA)) @ axes.T
        body.explicitinertial, body.mass = True, max(link.mass, SMALLEST)
        body.ipos, body.fullinertia = link.center, inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        kind = mujoco.mjtJoint.mjJNT_SLIDE if link.kind == SLIDE else mujoco.mjtJoint.mjJNT_HINGE
        body.add_joint(name=link.joint, type=kind, axis=link.axis, armature=link.armature)
        bodies.append(body)
    for name, joint, gain in motors:
        motor = spec.add_actuator(name=name, target=chain.joints[joint])
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        motor.gear[0] = gain
    spec.compile()
    return spec.to_xml()


def mjcf_of_plant(plant: ChainPlant) -> str:
    """The MJCF of a plant's chain, with a motor for each of its inputs."""
    layout = plant.layout
    return mjcf_of(plant.chain, [*zip(layout.inputs, layout.drives, plant.gains, strict=True)])


def text_of(path: str | Path) -> str:
    """The MJCF of a file with what it includes, whole in itself but for meshes.

    Raises:
        InputError: MuJoCo cannot load it.
    """
    load_mjcf(path)
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compile()
    return spec.to_xml()


def plant_of_text(text: str, name: str) -> ChainPlant:
    """The plant of an MJCF that is given as its text, see `plant_of`.

    Raises:
        InputError: MuJoCo cannot load it, or equations cannot say it.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plant.xml"
        write_bytes(path, text.encode())
        return replace(plant_of(path), name=name)
