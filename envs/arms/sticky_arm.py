"""An arm whose joints stick: what its sensors log while it moves, rests and is pushed.

The motors' currents follow a controller that the robot's owner cannot see into: a feed-forward of
a model, and a feedback of the errors of position and velocity. Where a joint is stuck, dry friction
takes up what these leave over, so that the current depends on how the joint came to rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np
from jaxtyping import Float

from envs.arms.motions import Targets
from mcpilco.recordings import ArmRecording
from mcpilco.typing import InputError

MODEL = Path(__file__).with_name("sticky_arm.xml")
"""the robot as its owner knows it: kinematics that are right, masses and friction that are not"""
TOOL = "tool"
"""the site that is pushed"""
SAMPLING_S = 0.008
"""between two samples of the log: 125 Hz [s]"""


@dataclass(frozen=True)
class Drives:
    """Motors, their controller and the noise of the sensors, a number for each joint."""

    torque_per_current: tuple[float, ...] = (12.0, 12.0, 9.0, 5.0, 5.0, 5.0)
    """[N m/A]"""
    stiffness: tuple[float, ...] = (12e3, 12e3, 8e3, 1200.0, 1200.0, 800.0)
    """of the feedback of position [N m/rad]"""
    damping: tuple[float, ...] = (480.0, 480.0, 250.0, 40.0, 40.0, 25.0)
    """of the feedback of velocity [N m s/rad]"""
    integral: tuple[float, ...] = (0.0,) * 6
    """of the feedback of the integrated error [N m/(rad s)]"""
    modelled: float = 0.95
    """share of the forces of inertia and gravity that the feed-forward knows [-]"""
    tells: Literal["feed_forward", "command"] = "feed_forward"
    """what is logged as the target of the current: without the feedback, or with it"""
    position_noise: float = 1e-5
    """standard deviation [rad]"""
    velocity_noise: float = 1e-3
    """standard deviation [rad/s]"""
    current_noise: float = 0.03
    """standard deviation [A]"""


PID = Drives(integral=(24e3, 24e3, 16e3, 2400.0, 2400.0, 1600.0), tells="command")
"""integral action, and a log of the whole command"""


@dataclass(frozen=True)
class Push:
    """A horizontal force at the tool, across the arm."""

    start_s: float
    """[s]"""
    torque: float
    """about the axis of the first joint, of which the force follows [N m]"""
    duration_s: float = 0.4
    """[s]"""
    rise_s: float = 0.02
    """in which it grows to its full force, and falls again at its end [s]"""


@dataclass(frozen=True)
class ArmLog(ArmRecording):
    """Samples of the arm as its sensors report them, and the truth about who pushed it.

    The target current is what the controller says that it wants, see `Drives.tells`.
    """

    joints: tuple[str, ...] = ()
    """names"""
    pushes: tuple[Push, ...] = ()
    """truth, as is `force`"""


@dataclass(frozen=True)
class StickyArm:
    """The arm that is simulated; its owner has `MODEL`."""

    model: mujoco.MjModel
    """with the true masses and friction"""
    drives: Drives = field(default_factory=Drives)

    @classmethod
    def drawn(cls, rng: np.random.Generator, drives: Drives | None = None) -> StickyArm:
        """An arm whose masses and friction differ from those of `MODEL` by up to a fifth."""
        model = mujoco.MjModel.from_xml_path(str(MODEL))
        scale = rng.uniform(0.8, 1.2, model.nbody)
        model.body_mass[:] *= scale
        model.body_inertia[:] *= scale[:, None]
        model.dof_frictionloss[:] *= rng.uniform(0.8, 1.2, model.nv)
        model.dof_damping[:] *= rng.uniform(0.8, 1.2, model.nv)
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return cls(model, drives or Drives())

    @property
    def joints(self) -> tuple[str, ...]:
        """Names."""
        return tuple(self.model.joint(j).name for j in range(self.model.njnt))

    def follow(
        self, targets: Targets, rng: np.random.Generator, pushes: Sequence[Push] = ()
    ) -> ArmLog:
        """The log of the arm while it follows its targets and is pushed.

        Targets are sampled every `model.opt.timestep`; where pushes overlap, their forces add.

        Raises:
            InputError: the targets are sampled at another time.
        """
        dt, every = self.model.opt.timestep, round(SAMPLING_S / self.model.opt.timestep)
        if not np.isclose(targets.dt, dt):
            raise InputError(f"targets must be sampled every {dt:g} s, got {targets.dt:g} s.")
        feed = self.drives.modelled * self._rigid(targets, every)
        position, velocity, current, reported, push = self._simulate(targets, feed, every, pushes)
        noise, shape = self.drives, position.shape
        return ArmLog(
            name="sticky arm",
            time=SAMPLING_S * np.arange(len(position)),
            position=position + noise.position_noise * rng.normal(size=shape),
            velocity=velocity + noise.velocity_noise * rng.normal(size=shape),
            current=current + noise.current_noise * rng.normal(size=shape),
            target_position=targets.q[targets.lead :: every],
            target_velocity=targets.dq[targets.lead :: every],
            target_current=reported,
            force=push,
            joints=self.joints,
            pushes=tuple(pushes),
        )

    def _rigid(self, targets: Targets, every: int) -> Float[np.ndarray, "K J"]:
        """Torques of inertia and gravity along the targets, once a sample of the log [N m]."""
        still = mujoco.MjModel.from_xml_path(str(MODEL))
        for name in ("body_mass", "body_inertia"):
            getattr(still, name)[:] = getattr(self.model, name)
        still.dof_frictionloss[:] = still.dof_damping[:] = 0.0
        data = mujoco.MjData(still)
        torques = np.empty((len(targets.q[::every]), still.nv))
        for k, torque in enumerate(torques):
            data.qpos[:], data.qvel[:] = targets.q[k * every], targets.dq[k * every]
            data.qacc[:] = targets.ddq[k * every]
            mujoco.mj_inverse(still, data)
            torque[:] = data.qfrc_inverse
        return torques

    def _simulate(
        self, targets: Targets, feed: np.ndarray, every: int, pushes: Sequence[Push]
    ) -> tuple[np.ndarray, ...]:
        """Positions, velocities, currents, reported currents and forces at the log's instants."""
        model, drives = self.model, self.drives
        data, site = mujoco.MjData(model), model.site(TOOL).id
        kp, kd, ki = (np.array(g) for g in (drives.stiffness, drives.damping, drives.integral))
        per_current, by_command = np.array(drives.torque_per_current), drives.tells == "command"
        size = _sizes(pushes, targets)
        data.qpos[:], data.qvel[:] = targets.q[0], targets.dq[0]
        summed, jacobian, rows = np.zeros(model.nv), np.zeros((3, model.nv)), []
        for k, (q, dq) in enumerate(zip(targets.q, targets.dq, strict=True)):
            error = q - data.qpos
            summed += ki * error * targets.dt
            torque = feed[k // every] + kp * error + kd * (dq - data.qvel) + summed
            force = np.zeros(3)
            data.qfrc_applied[:] = torque
            if size[k]:
                x, y, _ = data.site_xpos[site]
                force = size[k] / (x * x + y * y) * np.array([-y, x, 0.0])
                mujoco.mj_jacSite(model, data, jacobian, None, site)
                data.qfrc_applied[:] += jacobian.T @ force
            if k >= targets.lead and k % every == 0:
                reported = torque if by_command else feed[k // every]
                motion = data.qpos.copy(), data.qvel.copy()
                rows.append((*motion, torque / per_current, reported / per_current, force))
            mujoco.mj_step(model, data)
        return tuple(np.array(column) for column in zip(*rows, strict=True))


def _sizes(pushes: Sequence[Push], targets: Targets) -> Float[np.ndarray, " K"]:
    """Torque of all pushes about the first joint, at each step [N m]."""
    time = targets.dt * (np.arange(len(targets.q)) - targets.lead)
    total = np.zeros(len(time))
    for push in pushes:
        inside = np.minimum(time - push.start_s, push.start_s + push.duration_s - time)
        total += push.torque * np.clip(inside / push.rise_s, 0.0, 1.0)
    return total
