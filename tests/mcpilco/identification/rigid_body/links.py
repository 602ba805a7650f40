"""Parameters to project, and the projection as an independent solver finds it."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from mcpilco.bodies import HINGE, Body, Chain, inertial_parameters
from mcpilco.identification import RigidBody, pseudo_inertia


def random_links(rng: np.random.Generator, links: int, terms=("viscous",)) -> RigidBody:
    """Bodies of some masses each, so that they can exist."""
    bodies = []
    for number in range(links):
        points, masses = rng.normal(0.0, 0.1, (6, 3)), rng.uniform(0.1, 0.5, 6)
        center = masses @ points / masses.sum()
        away = points - center
        spread = np.einsum("p,pi,pj->ij", masses, away, away)
        inertia = np.trace(spread) * np.eye(3) - spread
        bodies.append(
            Body(
                name=f"link{number}",
                joint=f"joint{number}",
                kind=HINGE,
                axis=(0.0, 0.0, 1.0),
                mass=masses.sum(),
                parent=number - 1,
                center=tuple(center),
                inertia=tuple(map(tuple, inertia)),
            )
        )
    blocks = [np.append(inertial_parameters(b), rng.uniform(0.1, 1.0, len(terms))) for b in bodies]
    return RigidBody(Chain(tuple(bodies)), tuple(terms), np.concatenate(blocks))


def random_case(rng: np.random.Generator, links: int):
    """A chain, an estimate that is off by some tenths, and a metric of widely spread directions."""
    body = random_links(rng, links)
    D = len(body.nominal)
    typical = np.tile([1.0, 0.1, 0.1, 0.1, *[0.01] * 6, 0.5], links)
    estimate = body.nominal + 0.3 * typical * rng.normal(size=D)
    rows = rng.normal(size=(2 * D, D)) * 10.0 ** rng.uniform(-1.5, 0.0, D)
    rows = rows @ np.linalg.qr(rng.normal(size=(D, D)))[0] / typical
    return body, estimate, rows.T @ rows


def cost(theta, estimate, metric) -> float:
    return 0.5 * float((theta - estimate) @ metric @ (theta - estimate))


def least_eigenvalue(body: RigidBody, theta: np.ndarray) -> float:
    blocks = theta.reshape(-1, body.width)
    return float(np.linalg.eigvalsh(pseudo_inertia(blocks[:, :10])).min())


def solved_by_clarabel(body: RigidBody, estimate: np.ndarray, metric: np.ndarray) -> np.ndarray:
    """theta of the semidefinite program, for d = theta - estimate; viscous friction is last."""
    import clarabel

    D, width = len(estimate), body.width
    scale = np.sqrt(np.maximum(np.diag(metric), 1e-12))
    unit = pseudo_inertia(np.eye(10))
    rows, cones = [], []
    for k in range(len(body.chain.bodies)):
        for j, i in zip(*np.tril_indices(4), strict=True):  # the upper triangle by columns
            row = np.zeros(D)
            row[k * width : k * width + 10] = unit[:, i, j] * (1.0 if i == j else np.sqrt(2.0))
            rows.append(row)
        rows.append(np.eye(D)[k * width + 10])
        cones += [clarabel.PSDTriangleConeT(4), clarabel.NonnegativeConeT(1)]
    A = np.array(rows)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(metric / np.outer(scale, scale))),
        np.zeros(D),
        sparse.csc_matrix(-A / scale),
        A @ estimate,
        cones,
        settings,
    )
    return estimate + np.array(solver.solve().x) / scale
