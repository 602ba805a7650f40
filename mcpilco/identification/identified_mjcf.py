"""Parameters that were identified, written into the MJCF file that they belong to."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mcpilco.bodies import INERTIAL
from mcpilco.files import write_bytes
from mcpilco.identification.consistency import about_center, check
from mcpilco.identification.rigid_body import RigidBody
from mcpilco.plant import FAR, RIGID, SUDDEN, Inertials, move_assets, put
from mcpilco.typing import InputError


def write_identified_mjcf(
    source: str | Path, body: RigidBody, theta: np.ndarray, path: str | Path
) -> None:
    """Writes the model with these parameters; plain MuJoCo loads it.

    A body's mass, center and inertia hold all that moves with it. MuJoCo's own writer saves the
    model: with what the file included, without its comments, numbers to six digits.

    Args:
        source: MJCF file that the parameters are of.
        body: what the parameters belong to.
        theta: (D,), in the units of `body.units`, of bodies that can exist.
        path: the file to write.

    Raises:
        InputError: no body has such parameters, or MuJoCo refuses the model.
        RunFolderError: the file cannot be written.
    """
    wrong = [str(link) for link in check(body, theta) if not link.consistent]
    if wrong:
        raise InputError(
            f"parameters of bodies that can exist were expected, got {'; '.join(wrong)}; project "
            "them on consistent ones."
        )
    source, path = Path(source), Path(path)
    spec = mujoco.MjSpec.from_file(str(source))
    spec.compiler.fusestatic = False
    inertials = Inertials(spec, spec.compile())
    joints = {joint.name: joint for joint in spec.joints}
    for link, block in zip(body.chain.bodies, theta.reshape(-1, body.width), strict=True):
        inertials.replace(link.name, *about_center(block[: len(INERTIAL)]))
        terms = dict(zip(body.terms, block[len(INERTIAL) :], strict=True))
        _write_terms(joints[link.joint], terms, bool(spec.compiler.degree))
    inertials.write()
    move_assets(spec, source.parent, path.parent)
    try:
        spec.compile()
    except ValueError as error:
        raise InputError(f"MuJoCo refuses {source} with what was identified: {error}") from None
    write_bytes(path, spec.to_xml().encode())


def _write_terms(joint: Any, terms: dict[str, float], degrees: bool) -> None:
    if "viscous" in terms:
        put(joint, "damping", 0, terms["viscous"])
    if "coulomb" in terms:
        if joint.frictionloss == 0.0 and terms["coulomb"] > 0.0:
            joint.solimp_friction, joint.solref_friction = RIGID, SUDDEN
        joint.frictionloss = terms["coulomb"]
    if "armature" in terms:
        joint.armature = terms["armature"]
    if "stiffness" in terms or "offset" in terms:
        _write_spring(joint, terms.get("stiffness"), terms.get("offset"), degrees)


def _write_spring(joint: Any, k: float | None, offset: float | None, degrees: bool) -> None:
    """A joint's force k q + offset, as a spring about where it is 0."""
    hinge = joint.type == mujoco.mjtJoint.mjJNT_HINGE
    unit = math.radians(1.0) if hinge and degrees else 1.0
    before = float(np.ravel(joint.stiffness)[0])
    offset = -before * float(joint.springref) * unit if offset is None else offset
    k = before if k is None else k
    k = k or abs(offset) / FAR
    put(joint, "stiffness", 0, k)
    joint.springref = -offset / k / unit if k else 0.0
