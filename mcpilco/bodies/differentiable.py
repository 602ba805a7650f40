"""The regressor of a chain's inverse dynamics in torch, to be differentiated by the motion."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.bodies.chain import SLIDE, Body, Chain


def torch_regressor(chain: Chain, motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J J 10"]:
    """The regressor of `mcpilco.bodies.motion`, for motions [q, q', q''] of any batch shape.

    Each body's force and moment are found in its own frame, by unit parameters, and handed down
    from parent to parent, each of which feels them along the axis of its joint.

    Reference: Atkeson, An, Hollerbach, Estimation of inertial parameters of manipulator loads and
        links, International Journal of Robotics Research 5 (3), 1986.
    """
    J = len(chain.bodies)
    q, dq, ddq = (part.unbind(-1) for part in motion.split(J, -1))
    places = [_place(body, q[j]) for j, body in enumerate(chain.bodies)]
    wrenches = _wrenches(chain, places, dq, ddq)
    zero = motion.new_zeros(*motion.shape[:-1], 10)
    Y = [[zero] * J for _ in range(J)]
    for k in range(J):
        force, moment = wrenches[k]
        j = k
        while True:
            body, (R, p) = chain.bodies[j], places[j]
            axis = motion.new_tensor(body.axis)
            Y[j][k] = axis @ (force if body.kind == SLIDE else moment)
            j = body.parent
            if j < 0:
                break
            force = R @ force
            moment = R @ moment + _cross(p) @ force
    return torch.stack([torch.stack(row, -2) for row in Y], -3)


def _place(body: Body, q: Float[Tensor, "*b"]) -> tuple[Tensor, Tensor]:
    """R_pb and the origin of the body's frame in its parent's."""
    F, axis = q.new_tensor(body.rotation), q.new_tensor(body.axis)
    origin = q.new_tensor(body.origin).expand(*q.shape, 3)
    if body.kind == SLIDE:
        return F.expand(*q.shape, 3, 3), origin + q[..., None] * (F @ axis)
    # Rodrigues' formula
    K, one = _cross(axis), torch.eye(3, dtype=q.dtype)
    sin, cos = q.sin()[..., None, None], q.cos()[..., None, None]
    return F @ (one + sin * K + (1.0 - cos) * (K @ K)), origin


def _wrenches(chain: Chain, places, dq, ddq) -> list[tuple[Tensor, Tensor]]:
    """Force and moment (*b, 3, 10) that each body takes, by unit parameters, in its frame."""
    still = dq[0].new_zeros(*dq[0].shape, 3)
    against_gravity = still - dq[0].new_tensor(chain.gravity)
    moved: list[tuple[Tensor, Tensor, Tensor]] = []
    found = []
    for j, body in enumerate(chain.bodies):
        # w, w' and a of the parent's frame
        w, b, a = moved[body.parent] if body.parent >= 0 else (still, still, against_gravity)
        R, p = places[j]
        axis = w.new_tensor(body.axis)
        speed, growth = axis * dq[j][..., None], axis * ddq[j][..., None]
        a = a + b.cross(p, -1) + w.cross(w.cross(p, -1), -1)
        w, b, a = ((v[..., None, :] @ R).squeeze(-2) for v in (w, b, a))
        if body.kind == SLIDE:
            a = a + growth + 2.0 * w.cross(speed, -1)
        else:
            b = b + growth + w.cross(speed, -1)
            w = w + speed
        moved.append((w, b, a))
        found.append(_wrench(w, b, a))
    return found


def _wrench(w: Tensor, b: Tensor, a: Tensor) -> tuple[Tensor, Tensor]:
    """force = m a + w' x h + w x (w x h), moment = I w' + w x (I w) + h x a, by m, h and I."""
    W = _cross(w)
    none = torch.zeros_like(a)[..., None]
    force = torch.cat([a[..., None], _cross(b) + W @ W, none.expand(*none.shape[:-1], 6)], -1)
    moment = torch.cat([none, -_cross(a), _inertia(b) + W @ _inertia(w)], -1)
    return force, moment


def _cross(v: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b 3 3"]:
    """[v x], of v x u = [v x] u."""
    x, y, z = v.unbind(-1)
    o = torch.zeros_like(x)
    return torch.stack([o, -z, y, z, o, -x, -y, x, o], -1).unflatten(-1, (3, 3))


def _inertia(v: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b 3 6"]:
    """The matrix of I v by Ixx, Ixy, Ixz, Iyy, Iyz and Izz."""
    x, y, z = v.unbind(-1)
    o = torch.zeros_like(x)
    rows = [x, y, z, o, o, o, o, x, o, y, z, o, o, o, x, o, y, z]
    return torch.stack(rows, -1).unflatten(-1, (3, 6))
