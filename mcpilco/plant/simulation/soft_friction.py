"""Accelerations of joints whose dry friction is soft, as MuJoCo's own is.

Such a friction, -f (v + t a) / v_r and at most f either way, depends on the acceleration a that it
helps to make. Where a joint sticks it adds an inertia f t / v_r and damps the rest; where it slips
it is constant. The accelerations are where a convex function is least, which is found by Newton's
method along lines: each turn solves M a = tau as if it were known which joints stick.

Reference: MuJoCo documentation, Computation, "Constraint model" and "Solver parameters".
"""

from __future__ import annotations

from numba import njit

from mcpilco.bodies import INNER, anywhere, assemble, factorise, solve, where
from mcpilco.plant.effects.joint import SoftFriction
from mcpilco.plant.simulation.laws import code_of

SOFT = code_of(SoftFriction())
"""its code in the column `Tables.law`"""
TURNS = 20
"""most solutions; of all but few motions one or two are enough"""


@njit(**INNER)
def slip(tables, s, i, v, a):
    """How the friction i of a joint slips: 1 forwards, -1 backwards; 0 where it sticks."""
    ahead, sticks = v + tables.constants[s, i, 2] * a, tables.constants[s, i, 1]
    return where(ahead > sticks, 1.0, where(ahead < -sticks, -1.0, 0.0))


@njit(**INNER)
def friction(tables, s, i, v, a, slips):
    """Size of the friction i against the motion [N or N m], as if it slipped so at any speed."""
    f, v_r, t = tables.constants[s, i, 0], tables.constants[s, i, 1], tables.constants[s, i, 2]
    return f * where(slips == 0.0, (v + t * a) / v_r, slips)


@njit(**INNER)
def solve_as_if(tables, s, v, a, w, x):
    """The accelerations x if each joint slipped or stuck as it would with accelerations a."""
    J = len(x)
    for j in range(J):
        x[j], w.M[j, j] = w.bias[j], w.m[j]
        for k in range(j):
            w.M[j, k] = w.M[k, j]
    for i in range(len(tables.law)):
        if tables.law[i] == SOFT:
            j = tables.joint[i]
            slips = slip(tables, s, i, v[j], a[j])
            x[j] -= friction(tables, s, i, v[j], 0.0, slips)
            heavier = tables.constants[s, i, 0] * tables.constants[s, i, 2]
            w.M[j, j] += where(slips == 0.0, heavier / tables.constants[s, i, 1], 0.0)
    factorise(w)
    solve(w, x)


@njit(**INNER)
def slope(tables, s, v, a, x, asked, part):
    """Of the convex function, a part of the way from accelerations a to x.

    asked[j] are the frictions that would make a and x the accelerations.
    """
    total = 0.0 * part
    for i in range(len(tables.law)):
        if tables.law[i] == SOFT:
            j = tables.joint[i]
            way = x[j] - a[j]
            there = a[j] + part * way
            given = friction(tables, s, i, v[j], there, slip(tables, s, i, v[j], there))
            total += way * (given - asked[j, 0] - part * (asked[j, 1] - asked[j, 0]))
    return total


@njit(**INNER)
def least(tables, s, v, a, x, asked):
    """Where the convex function is least on the way from accelerations a to x, as a part of it.

    Its slope is linear between the edges at which a joint begins to slip or to stick.
    """
    low, high = 0.0 * x[0], 1.0 + 0.0 * x[0]
    falls, rises = slope(tables, s, v, a, x, asked, low), slope(tables, s, v, a, x, asked, high)
    beyond = rises <= 0.0
    for i in range(len(tables.law)):
        if tables.law[i] == SOFT:
            j = tables.joint[i]
            v_r, t = tables.constants[s, i, 1], tables.constants[s, i, 2]
            for way in (-1.0, 1.0):
                edge = ((way * v_r - v[j]) / t - a[j]) / (x[j] - a[j])
                within = (low < edge) & (edge < high)
                edge = where(within, edge, low)
                here = slope(tables, s, v, a, x, asked, edge)
                before, after = within & (here <= 0.0), within & (here > 0.0)
                low, falls = where(before, edge, low), where(before, here, falls)
                high, rises = where(after, edge, high), where(after, here, rises)
    return where(beyond, 1.0, low - falls * (high - low) / (rises - falls))


@njit(**INNER)
def accelerate_softly(tables, s, q, v, w, x, a):
    """Replaces the other forces x in the joints by the accelerations.

    Accelerations `a`, of a moment before, say which joints may stick; those found replace them.
    """
    J, asked = len(q), w.F
    assemble(tables.chains, s, q, v, w)
    for j in range(J):  # kept: the diagonal of M in w.m, the rest above it, x - bias in w.bias
        w.m[j], w.bias[j] = w.M[j, j], x[j] - w.bias[j]
        for k in range(j):
            w.M[k, j] = w.M[j, k]
    for turn in range(TURNS):
        solve_as_if(tables, s, v, a, w, x)
        wrong = x[0] < x[0]
        for i in range(len(tables.law)):
            if tables.law[i] == SOFT:
                j = tables.joint[i]
                slips = slip(tables, s, i, v[j], a[j])
                wrong = wrong | (slips != slip(tables, s, i, v[j], x[j]))
                asked[j, 1] = friction(tables, s, i, v[j], x[j], slips)
        if not anywhere(wrong):
            break
        part = 1.0 + 0.0 * x[0]
        if turn > 0:  # of the first `a` it is not known which frictions would make it
            part = where(wrong, least(tables, s, v, a, x, asked), 1.0)
        for j in range(J):
            a[j] = where(part == 1.0, x[j], a[j] + part * (x[j] - a[j]))
            asked[j, 0] = where(
                part == 1.0, asked[j, 1], asked[j, 0] + part * (asked[j, 1] - asked[j, 0])
            )
    for j in range(J):
        a[j] = x[j]
