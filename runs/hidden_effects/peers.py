"""The effects that sparse regressions name on the same recordings: PySINDy's and scikit-learn's.

Both get what they are usually given: positions that a Savitzky-Golay filter differentiates, the
forces that the nominal plant leaves over by its inverse dynamics, and a library of terms, which are
the regressors of our effects where these are linear in a parameter. A term that is left with a
coefficient names its effect. Neither has a word for what is not in the library.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.signal import savgol_filter

from mcpilco.bodies import Chain, generalised_forces
from mcpilco.plant import Plant
from mcpilco.recordings import Recording

SAMPLES, ORDER = 11, 4
"""of the Savitzky-Golay filter"""
THRESHOLDS = np.geomspace(0.02, 0.6, 12)
"""of the thresholded least squares, in std of the forces left over; the best BIC is taken"""
SURE = 3.0
"""posterior std that a coefficient of the ARD regression must be from 0"""

Term = tuple[str, str]
"""effect and target"""
Forces = Float[np.ndarray, "N J"]


def peers(plant: Plant, recordings: Sequence[Recording]) -> dict[str, list[Term]]:
    """The effects that each names."""
    terms, columns, goal = regression(plant, recordings)
    size = np.linalg.norm(columns, axis=0) / np.sqrt(len(columns))
    seen = np.flatnonzero(size > 1e-9)
    X, y = columns[:, seen] / size[seen], goal / goal.std()
    chosen = {"PySINDy": _thresholded(X, y), "ARD regression": _relevant(X, y)}
    return {name: [terms[seen[k]] for k in np.flatnonzero(kept)] for name, kept in chosen.items()}


def regression(
    plant: Plant, recordings: Sequence[Recording]
) -> tuple[list[Term], Float[np.ndarray, "n K"], Float[np.ndarray, " n"]]:
    """Terms, their regressors, and the force left over; a joint's rows in its rms of that force."""
    parts = [_moved(plant, recording) for recording in recordings]
    q, v, a, u, before = (np.concatenate(rows) for rows in zip(*parts, strict=True))
    applied = _into_joints(plant, u)
    damping = np.zeros(len(plant.layout.joints))
    values = {parameter.name: parameter.value for parameter in plant.parameters}
    for base in plant.base:
        if base.active.effect.name == "viscous_friction":
            damping[plant.layout.joint_of(base.active.target)] += values[str(base.values[0])]
    missing = generalised_forces(plant.chain, q, v, a) - applied + damping * v
    scale = np.sqrt(np.mean(missing**2, axis=0))
    library = _library(plant, q, v, a, u, before)
    columns = np.stack([(force / scale).ravel() for force in library.values()], axis=1)
    return list(library), columns, (missing / scale).ravel()


def _moved(plant: Plant, recording: Recording) -> tuple[np.ndarray, ...]:
    """Positions, velocities, accelerations, commands and those before, inside a recording."""
    q = recording.states[:, 0::2].copy()
    for column in q.T:
        known = np.isfinite(column)
        column[:] = np.interp(recording.time, recording.time[known], column[known])
    smooth = [savgol_filter(q, SAMPLES, ORDER, d, recording.dt, axis=0) for d in (0, 1, 2)]
    u = recording.inputs
    u = 0.5 * (u + np.roll(u, 1, axis=0))  # a command is held from its sample to the next
    inside = slice(SAMPLES, -SAMPLES)
    return *(rows[inside] for rows in smooth), u[inside], np.roll(u, 1, axis=0)[inside]


def _into_joints(plant: Plant, u: Float[np.ndarray, "N U"]) -> Forces:
    """Forces of the inputs at the joints."""
    forces = np.zeros((len(u), len(plant.layout.joints)))
    for number, j in enumerate(plant.layout.drives):
        forces[:, j] += u[:, number]
    return forces


def _library(
    plant: Plant,
    q: Forces,
    v: Forces,
    a: Forces,
    u: Float[np.ndarray, "N U"],
    before: Float[np.ndarray, "N U"],
) -> dict[Term, Forces]:
    """The force of each effect at each of its targets, for one unit of its parameter."""
    layout, terms = plant.layout, {}

    def only(j: int, force: Float[np.ndarray, " N"]) -> Forces:
        return force[:, None] * np.eye(len(layout.joints))[j]

    for j, joint in enumerate(layout.joints):
        x, w = q[:, j], v[:, j]
        terms["viscous_friction", joint] = only(j, -w)
        terms["coulomb_friction", joint] = only(j, -np.sign(w))
        terms["quadratic_drag", joint] = only(j, -w * np.abs(w))
        terms["spring", joint] = only(j, -x)
        terms["hardening_spring", joint] = only(j, -(x**3))
        terms["constant_force", joint] = only(j, np.ones(len(x)))
        terms["armature", joint] = only(j, -a[:, j])
    for b, body in enumerate(layout.bodies):
        for name, change in _changes(plant.chain, b).items():
            moved = generalised_forces(change(1e-3), q, v, a)
            back = generalised_forces(change(-1e-3), q, v, a)
            terms[name, body] = -(moved - back) / 2e-3
    for number, actuator in enumerate(layout.actuators):
        command = u[:, [number]]
        at = np.eye(len(layout.joints))[layout.drives[number]]
        terms["actuator_gain", actuator] = command * at
        terms["actuator_dead_zone", actuator] = -np.sign(command) * at
        terms["actuator_delay", actuator] = (before[:, [number]] - command) * at
    return terms


def _changes(chain: Chain, b: int) -> dict[str, Callable[[float], Chain]]:
    """The chain with another mass, center or inertia of a body, by a part of what it is."""
    body = chain.bodies[b]

    def changed(**values: object) -> Chain:
        bodies = list(chain.bodies)
        bodies[b] = replace(body, **values)  # type: ignore[arg-type]
        return replace(chain, bodies=tuple(bodies))

    def mass(part: float) -> Chain:
        inertia = tuple(map(tuple, (1.0 + part) * np.array(body.inertia)))
        return changed(mass=(1.0 + part) * body.mass, inertia=inertia)

    def center(part: float) -> Chain:
        return changed(center=tuple((1.0 + part) * np.array(body.center)))

    found: dict[str, Callable[[float], Chain]] = {"body_mass": mass}
    if np.any(body.center):
        found["center_of_mass"] = center
    return found


def _thresholded(X: Float[np.ndarray, "n K"], y: Float[np.ndarray, " n"]) -> np.ndarray:
    """Which terms PySINDy's sequentially thresholded least squares keeps."""
    from pysindy.optimizers import STLSQ

    best, least = np.zeros(X.shape[1], dtype=bool), len(y) * np.log(np.mean(y**2))
    for threshold in THRESHOLDS:
        optimizer = STLSQ(threshold=threshold, alpha=1e-6)
        optimizer.fit(X, y[:, None])
        coefficients = np.asarray(optimizer.coef_)[0]
        kept = coefficients != 0.0
        bic = len(y) * np.log(np.mean((y - X @ coefficients) ** 2)) + kept.sum() * np.log(len(y))
        if bic < least:
            best, least = kept, bic
    return best


def _relevant(X: Float[np.ndarray, "n K"], y: Float[np.ndarray, " n"]) -> np.ndarray:
    """Which terms the ARD regression keeps, surely."""
    from sklearn.linear_model import ARDRegression

    found = ARDRegression(fit_intercept=False).fit(X, y)
    kept = np.abs(found.coef_) > 0.0
    std = np.full(X.shape[1], np.inf)
    std[found.lambda_ < found.threshold_lambda] = np.sqrt(np.diag(found.sigma_))
    return kept & (np.abs(found.coef_) > SURE * std)
