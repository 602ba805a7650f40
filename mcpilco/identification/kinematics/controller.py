"""Joint motions that bring a robot's tip to a pose, by the gradient of a learned model."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.identification.kinematics.forward import ForwardKinematics
from mcpilco.typing import InputError

Joints = Float[Tensor, " J"]
"""positions [rad or m]"""
Target = tuple[Tensor, Tensor]
"""position [m] and rotation matrix"""
Error = tuple[Tensor, Tensor]
"""of the position [m], and a rotation vector [rad]"""

_DAMPING = 1e-3
"""at the start, in parts of the largest diagonal entry of J^T J [-]"""
_LARGEST_STEP = 0.2
"""of a joint in one step of a descent [rad or m]"""
_STUCK = 1e8
"""damping at which no step makes the error smaller [-]"""


@dataclass(frozen=True)
class Reach:
    """How a pose is approached."""

    length: float = 0.3
    """as many metres as an error of 1 rad counts: about the size of the tool [m/rad]"""
    position: float = 1e-4
    """error of position at which the goal is reached [m]"""
    orientation: float = 1e-3
    """likewise of orientation [rad]"""
    largest_step: float = 0.05
    """largest change of a joint from one reference to the next [rad or m]"""
    steps: int = 200
    """most steps of a descent"""

    def __post_init__(self) -> None:
        for name in ("length", "position", "orientation", "largest_step", "steps"):
            if getattr(self, name) <= 0:
                raise InputError(f"Reach.{name} must be positive, got {getattr(self, name)}.")


@dataclass(frozen=True, eq=False)
class Path:
    """References for the joints' own controllers, from the start to the goal."""

    q: Float[Tensor, "steps J"]
    """one a sampling time [rad or m]"""
    converged: bool
    """the model's pose at the end is the target, within the tolerances"""
    position_error: float
    """at the end, by the model [m]"""
    orientation_error: float
    """likewise [rad]"""


def reach(
    model: ForwardKinematics,
    start: Joints,
    position: Float[Tensor, " 3"],
    rotation: Float[Tensor, "3 3"],
    config: Reach | None = None,
) -> Path:
    """Joint references that lead from a configuration to a pose, by descent on the pose's error.

    The descent stays within the joint positions of the model's samples, for beyond them it knows
    nothing. Where it ends beside the target, in a local minimum, the path goes to that sample whose
    pose is nearest to the target first, and descends from there; the better of the two is returned.

    The start is in the order of `model.joints` [rad or m]; the target has a position [m] and a
    rotation from the marker's frame to the camera's, both in the camera's frame.

    Reference: thesis eq. (2.24), q <- q - nu grad |p* - p|, with one number for metres and radians.
    Differs: the gradient of that norm is as long beside the target as far from it, and never comes
    to rest: here it is that of the square. Metres and radians are weighed by a length, and an
    orientation's error is a rotation vector, for differences of angles are none. The step nu is
    found by damping (Levenberg-Marquardt) in place of a constant, and the joints' steps are small.
    """
    config = config or Reach()
    target = position, rotation
    straight, error = _descent(model, _inside(model, start), target, config)
    parts = [straight]
    if not _reached(error, config):
        sizes = _weighed(pose_error(model, model.q, target), config).norm(dim=-1)
        detour = model.q[int(sizes.argmin())]  # the sample whose pose is nearest to the target
        onward, other = _descent(model, detour, target, config)
        if _size(other, config) < _size(error, config):
            parts, error = [detour[None], onward], other
    return _path(start, parts, error, config)


def pose_error(
    model: ForwardKinematics, q: Float[Tensor, "*b J"], target: Target
) -> tuple[Float[Tensor, "*b 3"], Float[Tensor, "*b 3"]]:
    """Target less pose: of the position [m], and as rotation vector in the camera's frame [rad]."""
    p, R = model.pose(q)
    return target[0] - p, _rotation_vector(target[1] @ R.mT)


def _rotation_vector(R: Float[Tensor, "*b 3 3"]) -> Float[Tensor, "*b 3"]:
    """The logarithm of rotations; at half a turn some axis of those possible.

    With s = sin(angle) axis and c = cos(angle), the vector is s angle / sin(angle).
    """
    skew = R - R.mT
    s = 0.5 * torch.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], -1)
    c = 0.5 * (R.diagonal(dim1=-2, dim2=-1).sum(-1) - 1.0)
    size = (s.square().sum(-1) + 1e-24).sqrt()  # smooth at 0, where the factor is 1
    return s * (torch.atan2(size, c) / size)[..., None]


def _weighed(error: Error, config: Reach) -> Float[Tensor, "*b 6"]:
    return torch.cat([error[0], config.length * error[1]], -1)


def _size(error: Error, config: Reach) -> float:
    return float(_weighed(error, config).norm())


def _reached(error: Error, config: Reach) -> bool:
    return bool(error[0].norm() <= config.position and error[1].norm() <= config.orientation)


def _inside(model: ForwardKinematics, q: Joints) -> Joints:
    return q.clamp(model.q.amin(0), model.q.amax(0))


def _descent(
    model: ForwardKinematics, q: Joints, target: Target, config: Reach
) -> tuple[Float[Tensor, "steps J"], Error]:
    """The configurations of a damped descent, and the error at the last one."""
    path, damping, low, high = [q], _DAMPING, model.q.amin(0), model.q.amax(0)
    error = pose_error(model, q, target)
    for _ in range(config.steps):
        if _reached(error, config) or damping > _STUCK:
            break
        e = _weighed(error, config)
        J = torch.autograd.functional.jacobian(
            lambda q: _weighed(pose_error(model, q, target), config), q
        )
        g = J.T @ e  # grad 1/2 |e|^2;  the step is -(J^T J + mu I)^-1 g
        J[:, ((q <= low) & (g > 0)) | ((q >= high) & (g < 0))] = 0.0  # it would leave its range
        A, g = J.T @ J, J.T @ e
        identity = float(A.diagonal().amax()) * torch.eye(len(q), dtype=q.dtype)
        while damping <= _STUCK:
            step = -torch.linalg.solve(A + damping * identity, g)
            step = step * min(1.0, _LARGEST_STEP / float(step.abs().amax().clamp(min=1e-12)))
            there = _inside(model, q + step)
            new = pose_error(model, there, target)
            if _size(new, config) < float(e.norm()):
                q, error, damping = there, new, max(damping / 5, 1e-12)
                path.append(q)
                break
            damping *= 4
    return torch.stack(path), error


def _path(start: Joints, parts: list[Float[Tensor, "_ J"]], error: Error, config: Reach) -> Path:
    """The parts behind one another, with further references where two are far apart."""
    corners = torch.cat([start[None], *parts])
    q = [corners[:1]]
    for a, b in pairwise(corners):
        count = max(1, int(torch.ceil((b - a).abs().amax() / config.largest_step - 1e-9)))
        q.append(a + (b - a) * (torch.arange(1, count + 1, dtype=a.dtype) / count)[:, None])
    return Path(
        torch.cat(q), _reached(error, config), float(error[0].norm()), float(error[1].norm())
    )
