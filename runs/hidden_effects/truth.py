"""Plants with hidden effects, simulated by other means than mcpilco's: fixed Runge-Kutta steps of
0.25 ms, equations in closed form, and a friction that turns over as v / sqrt(v^2 + w^2)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

STEP = 2.5e-4
CART_POLE, PENDULUM, DOUBLE_PENDULUM, ROTARY_PENDULUM = range(4)
AXIAL = 1e-5  # inertia of the rotary pendulum's rod about its length
# numbers of a joint
(
    VISCOUS,
    COULOMB,
    EXTRA,
    SPEED,
    DRAG,
    PLUS,
    MINUS,
    SPRING,
    CUBIC,
    CONSTANT,
    SIN,
    COS,
    WAVES,
    ARMATURE,
) = range(14)
# outside the catalogue: detent (magnet), feeding energy, patch, coupling
DETENT, FEED, PATCH, COUPLING = range(14, 18)
FORWARD, BACKWARD, LOAD = range(18, 21)
# a cable: a force with hysteresis, the way after which it turns over, where it is on that way
CABLE, REACH, WAY = range(21, 24)
TILT = 24  # of the first joint's base
# a motor under a voltage: what its speed takes off, the lag of its current; one behind a spring:
# its inertia, the spring, its damping, half of the play between them
BRAKE, INDUCTANCE, ROTOR, STIFFNESS, DAMPING, GAP = range(25, 31)
NUMBERS = 31
# per actuator: gain, dead zone, limit, delay, lag, play, more dead zone below 0, rate
# per body: mass, moment, inertia about the joint


@njit(cache=True)
def joint_force(q, v, tau, p, width):
    sign = v / math.sqrt(v * v + width * width)
    force = -p[VISCOUS] * v - p[DRAG] * v * abs(v) - p[SPRING] * q - p[CUBIC] * q**3 + p[CONSTANT]
    dry = p[COULOMB]
    if p[SPEED] > 0.0:
        dry += p[EXTRA] * math.exp(-((v / p[SPEED]) ** 2))
    dry += p[PLUS] if v > 0.0 else p[MINUS]
    if p[PATCH] > 0.0 and 0.3 < q < 0.8:
        dry += p[PATCH]
    dry += p[LOAD] * abs(tau)
    force -= dry * sign + (p[FORWARD] if v > 0.0 else p[BACKWARD]) * v
    force -= p[CABLE] * p[WAY]
    force += p[SIN] * math.sin(p[WAVES] * q) + p[COS] * math.cos(p[WAVES] * q)
    if p[DETENT] != 0.0:
        force -= p[DETENT] * (q - 0.4) * math.exp(-(((q - 0.4) / 0.1) ** 2)) / 0.1
    if p[FEED] != 0.0:
        force += p[FEED] * v / (1.0 + v * v)
    return force


@njit(cache=True)
def transmit(q, v, tau, joint, angle, speed, passed, turned):
    """The torque of its motor that reaches each joint, and a motor's own acceleration."""
    for j in range(len(q)):
        passed[j], turned[j] = tau[j], 0.0
        if joint[j, ROTOR] > 0.0:
            twist, gap = angle[j] - q[j], joint[j, GAP]
            passed[j] = 0.0
            if abs(twist) >= gap:
                pressed = twist - math.copysign(gap, twist)
                damped = joint[j, DAMPING] * (speed[j] - v[j])
                passed[j] = joint[j, STIFFNESS] * pressed + damped
            turned[j] = (tau[j] - passed[j]) / joint[j, ROTOR]


@njit(cache=True)
def acceleration(kind, q, v, tau, body, joint, g, width, out):
    t0 = tau[0] + joint_force(q[0], v[0], tau[0], joint[0], width)
    tilt = joint[0, TILT]
    if kind == PENDULUM:
        out[0] = (t0 - body[0, 1] * g * math.sin(q[0] + tilt)) / (body[0, 2] + joint[0, ARMATURE])
        return
    t1 = tau[1] + joint_force(q[1], v[1], tau[1], joint[1], width)
    t0 -= joint[0, COUPLING] * math.sin(2.0 * q[1])
    t1 -= joint[0, COUPLING] * math.cos(2.0 * q[1]) * q[0]
    if kind == CART_POLE:
        h = body[1, 1]
        m11, m22 = body[0, 0] + body[1, 0] + joint[0, ARMATURE], body[1, 2] + joint[1, ARMATURE]
        m12 = h * math.cos(q[1])
        f0 = t0 + h * math.sin(q[1]) * v[1] ** 2
        f0 -= (body[0, 0] + body[1, 0]) * g * math.sin(tilt)
        f1 = t1 - h * g * math.sin(q[1] + tilt)
    elif kind == ROTARY_PENDULUM:
        # 2 T = (J + m r^2 + I s^2 + A c^2) a'^2 + 2 h r c a' b' + I b'^2,  V = -h g c
        h, inertia, r = body[1, 1], body[1, 2], body[0, 3]
        s, c = math.sin(q[1]), math.cos(q[1])
        m11 = body[0, 2] + body[1, 0] * r**2 + inertia * s**2 + AXIAL * c**2 + joint[0, ARMATURE]
        m12, m22 = h * r * c, inertia + joint[1, ARMATURE]
        f0 = t0 - 2.0 * (inertia - AXIAL) * s * c * v[0] * v[1] + h * r * s * v[1] ** 2
        f1 = t1 + (inertia - AXIAL) * s * c * v[0] ** 2 - h * g * s
    else:
        length = body[0, 3]
        h2, c2, s2 = body[1, 1], math.cos(q[1]), math.sin(q[1])
        m22 = body[1, 2]
        m12 = m22 + length * h2 * c2
        m11 = body[0, 2] + m22 + body[1, 0] * length**2 + 2.0 * length * h2 * c2
        c = length * h2 * s2
        f0 = t0 + c * (2.0 * v[0] * v[1] + v[1] ** 2)
        f1 = t1 - c * v[0] ** 2
        f0 -= g * (
            (body[0, 1] + body[1, 0] * length) * math.sin(q[0] + tilt)
            + h2 * math.sin(q[0] + q[1] + tilt)
        )
        f1 -= g * h2 * math.sin(q[0] + q[1] + tilt)
        m11 += joint[0, ARMATURE]
        m22 += joint[1, ARMATURE]
    det = m11 * m22 - m12 * m12
    out[0] = (m22 * f0 - m12 * f1) / det
    out[1] = (m11 * f1 - m12 * f0) / det


@njit(cache=True)
def begin(kind, q, v, tau, body, joint, g, width, angle, current):
    """Sets what cables, currents and motors are at before: those of a motion that goes on."""
    a, through = np.zeros(len(q)), tau.copy()
    for j in range(len(q)):
        current[j] = tau[j] - joint[j, BRAKE] * v[j]
        joint[j, WAY] = np.sign(v[j])
    for _ in range(30):
        acceleration(kind, q, v, through, body, joint, g, width, a)
        through[:] = 0.5 * (through + tau - joint[:, ROTOR] * a)
    for j in range(len(q)):
        if joint[j, ROTOR] > 0.0:
            slack = math.copysign(joint[j, GAP], through[j])
            angle[j] = q[j] + through[j] / joint[j, STIFFNESS] + slack


@njit(cache=True)
def simulate(kind, start, commands, feedback, dt, body, joint, actuator, drives, g, width):
    """States (T, 2 J) at the samples; what is fed back of them, (U, 2 J), joins the commands."""
    J, T, U = len(start) // 2, len(commands), commands.shape[1]
    n = round(dt / STEP)
    shaped = np.empty_like(commands)
    q, v, joint = start[0::2].copy(), start[1::2].copy(), joint.copy()
    last = np.zeros(U)
    level = np.zeros(U)
    out = np.empty((T, 2 * J))
    half = 0.5 * STEP
    tau = np.zeros(J)
    a1, a2, a3, a4 = np.zeros(J), np.zeros(J), np.zeros(J), np.zeros(J)
    b1, b2, b3, b4 = np.zeros(J), np.zeros(J), np.zeros(J), np.zeros(J)
    angle, speed, current, through = q.copy(), v.copy(), np.zeros(J), np.zeros(J)
    for k in range(T):
        for j in range(J):
            out[k, 2 * j], out[k, 2 * j + 1] = q[j], v[j]
        for u in range(U):
            for x in range(2 * J):
                commands[k, u] -= feedback[u, x] * out[k, x]
            x = actuator[u, 0] * commands[k, u]
            d = actuator[u, 1]
            x = max(x - d, 0.0) + min(x + d + actuator[u, 6], 0.0)
            x = min(max(x, -actuator[u, 2]), actuator[u, 2])
            p = actuator[u, 5]
            if k == 0:
                last[u] = level[u] = x
            if p > 0.0:
                x = min(max(last[u], x - p), x + p)
            last[u] = x
            shaped[k, u] = x
        if k == 0:
            tau[:] = 0.0
            for u in range(U):
                tau[drives[u]] += level[u]
            begin(kind, q, v, tau, body, joint, g, width, angle, current)
        for i in range(n):
            t = k * dt + (i + 0.5) * STEP
            tau[:] = 0.0
            for u in range(U):
                at = math.floor((t - actuator[u, 3]) / dt)
                goal = shaped[max(at, 0), u]
                if actuator[u, 4] > 0.0:
                    decay = math.exp(-STEP / actuator[u, 4])
                    middle = goal + (level[u] - goal) * math.exp(-0.5 * STEP / actuator[u, 4])
                    level[u] = goal + (level[u] - goal) * decay
                    tau[drives[u]] += middle
                elif actuator[u, 7] < np.inf:
                    before, most = level[u], STEP * actuator[u, 7]
                    level[u] = min(max(goal, before - most), before + most)
                    tau[drives[u]] += 0.5 * (before + level[u])
                else:
                    tau[drives[u]] += goal
            for j in range(J):
                if joint[j, CABLE] > 0.0:
                    to = math.copysign(1.0, v[j])
                    left = math.exp(-STEP * abs(v[j]) / joint[j, REACH])
                    joint[j, WAY] = to + (joint[j, WAY] - to) * left
                if joint[j, INDUCTANCE] > 0.0:
                    goal, before = tau[j] - joint[j, BRAKE] * v[j], current[j]
                    current[j] = goal + (before - goal) * math.exp(-STEP / joint[j, INDUCTANCE])
                    tau[j] = 0.5 * (before + current[j])
            transmit(q, v, tau, joint, angle, speed, through, b1)
            acceleration(kind, q, v, through, body, joint, g, width, a1)
            v2, s2 = v + half * a1, speed + half * b1
            transmit(q + half * v, v2, tau, joint, angle + half * speed, s2, through, b2)
            acceleration(kind, q + half * v, v2, through, body, joint, g, width, a2)
            v3, s3 = v + half * a2, speed + half * b2
            transmit(q + half * v2, v3, tau, joint, angle + half * s2, s3, through, b3)
            acceleration(kind, q + half * v2, v3, through, body, joint, g, width, a3)
            v4, s4 = v + STEP * a3, speed + STEP * b3
            transmit(q + STEP * v3, v4, tau, joint, angle + STEP * s3, s4, through, b4)
            acceleration(kind, q + STEP * v3, v4, through, body, joint, g, width, a4)
            q = q + STEP * v + STEP**2 / 6.0 * (a1 + a2 + a3)
            v = v + STEP / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
            angle = angle + STEP * speed + STEP**2 / 6.0 * (b1 + b2 + b3)
            speed = speed + STEP / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4)
    return out
