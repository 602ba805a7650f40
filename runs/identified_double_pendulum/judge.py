"""What parameters are worth: torques, and half a second of free motion, of another recording."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from identified_double_pendulum.motion import SMOOTHED, Motion, low_passed
from jaxtyping import Float

from envs.plants import double_pendulum
from mcpilco.bodies import INERTIAL, Chain
from mcpilco.identification import RigidBody, inertia_of
from mcpilco.plant import CATALOGUE, Base, ChainPlant, EffectInstance, Plant

HORIZON_S, EVERY_S = 0.5, 0.1
"""length of a prediction, and from the start of one to the next [s]"""
TURN = 2e-3
"""velocity over which our dry friction turns over [rad/s], as that of the regressor"""
SLOPE = 100.0
"""of the authors' dry friction, cf atan(100 q')"""


@dataclass(frozen=True)
class Errors:
    """Of a model on a recording that it has not seen."""

    torque: Float[np.ndarray, " 2"]
    """rms over the samples [N m]"""
    angle: Float[np.ndarray, " 2"]
    """rms over the predictions at their end [rad]"""


def without_friction(robot: RigidBody) -> Float[np.ndarray, " D"]:
    """The authors' masses, without friction and motors' inertias."""
    theta = robot.nominal.reshape(-1, robot.width).copy()
    theta[:, len(INERTIAL) :] = 0.0
    return theta.ravel()


def errors(
    robot: RigidBody, theta: Float[np.ndarray, " D"], unseen: Motion, slope: float | None = None
) -> Errors:
    """What a model misses of a recording's torques, and of half a second of free motion.

    Args:
        robot: what theta belongs to.
        theta: its parameters.
        unseen: the recording.
        slope: where dry friction is f_c 2/pi atan(slope q'), as the authors have it [s/rad]; else
            it is f_c tanh(q' / v_r).
    """
    Y = robot.regressor(unseen.q, unseen.dq, unseen.ddq)
    turn = TURN
    if slope is not None:
        Y[..., coulomb(robot)] *= softness(unseen.dq, slope)
        turn = 0.5 * np.pi / slope  # tanh with the same slope, which is a little sharper
    torque = low_passed(unseen.tau) - low_passed(Y) @ theta
    return Errors(rms(torque), rms(missed(plant(robot, theta, turn), unseen)))


def coulomb(robot: RigidBody) -> list[int]:
    """Columns of dry friction."""
    return [n for n, name in enumerate(robot.names) if name.endswith("_coulomb")]


def softness(dq: Float[np.ndarray, "N 2"], slope: float) -> Float[np.ndarray, "N 1 2"]:
    """The authors' law of dry friction over ours, both with plateaus of 1."""
    ours = np.tanh(dq / TURN)
    ours = np.where(ours == 0.0, 1.0, ours)
    return (np.arctan(slope * dq) / (0.5 * np.pi) / ours)[:, None]


def rms(x: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, " 2"]:
    return np.sqrt(np.mean(x**2, axis=0))


def missed(plant: Plant, unseen: Motion) -> Float[np.ndarray, "W 2"]:
    """Errors of the angles at the end of predictions: smoothed starts, measured torques."""
    recording = unseen.recording
    steps, stride = round(HORIZON_S / recording.dt), round(EVERY_S / recording.dt)
    first = np.arange(0, len(unseen.q) - steps, stride)
    start = np.stack([unseen.q, unseen.dq], axis=2)[first].reshape(len(first), 4)
    shift = SMOOTHED // 2
    inputs = np.stack([recording.inputs[shift + n : shift + n + steps] for n in first])
    found = plant.simulate(start, inputs, recording.dt)
    return unseen.q[first + steps] - found[:, -1, 0::2]


def plant(robot: RigidBody, theta: Float[np.ndarray, " D"], turn: float) -> ChainPlant:
    """A plant with these parameters."""
    blocks = theta.reshape(-1, robot.width)
    bodies = []
    for body, block in zip(robot.chain.bodies, blocks, strict=True):
        mass, center = block[0], block[1:4] / block[0]
        about = inertia_of(block[:10]) - mass * (
            center @ center * np.eye(3) - np.outer(center, center)
        )
        inertia = tuple(map(tuple, about))
        bodies.append(
            replace(body, mass=mass, center=tuple(center), inertia=inertia, armature=block[12])
        )
    chain = Chain(tuple(bodies), robot.chain.gravity)
    friction = []
    for joint, block in zip(robot.chain.joints, blocks, strict=True):
        friction.append(Base(EffectInstance(CATALOGUE["viscous_friction"], joint), (block[10],)))
        friction.append(
            Base(EffectInstance(CATALOGUE["coulomb_friction"], joint), (block[11], turn))
        )
    layout = double_pendulum().layout
    return ChainPlant(
        "double_pendulum", layout, (), lambda _: chain, base=tuple(friction), angles=(0, 2)
    )
