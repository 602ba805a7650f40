"""Physical consistency of inertial parameters, link by link.

A body's mass m, first moment h and inertia I about the origin are those of some distribution of
(positive) masses exactly where its pseudo-inertia

    J = [ tr(I)/2 1 - I   h ]  =  sum over masses of  m [x; 1] [x; 1]^T
        [ h^T             m ]

is positive semidefinite. J is linear in the parameters.

Reference: Wensing, Kim, Slotine, Linear matrix inequalities for physically consistent inertial
    parameter identification, IEEE Robotics and Automation Letters 3 (1), 2018.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from mcpilco.bodies import INERTIAL
from mcpilco.identification.rigid_body.body import TERMS, RigidBody

ROUNDING = 1e-9
"""how negative an eigenvalue of J may be that is called 0, relative to the largest [-]"""
LEAST_MASS = 1e-6
"""MuJoCo wants bodies that move to have mass [kg]"""
LEAST_INERTIA = 1e-10
"""and inertia [kg m^2]"""
_ROWS, _COLUMNS = np.triu_indices(3)


def pseudo_inertia(theta: Float[np.ndarray, "*b 10"]) -> Float[np.ndarray, "*b 4 4"]:
    """J of inertial parameters [kg m^2, kg m, kg]."""
    inertia = inertia_of(theta)
    trace = np.trace(inertia, axis1=-2, axis2=-1)[..., None, None]
    J = np.empty((*theta.shape[:-1], 4, 4))
    J[..., :3, :3] = 0.5 * trace * np.eye(3) - inertia
    J[..., :3, 3] = J[..., 3, :3] = theta[..., 1:4]
    J[..., 3, 3] = theta[..., 0]
    return J


def from_pseudo_inertia(J: Float[np.ndarray, "*b 4 4"]) -> Float[np.ndarray, "*b 10"]:
    """The inertial parameters of J: I = tr(S) 1 - S of its upper block S."""
    S = J[..., :3, :3]
    inertia = np.trace(S, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - S
    six = inertia[..., _ROWS, _COLUMNS]
    return np.concatenate([J[..., 3, 3:], J[..., :3, 3], six], axis=-1)


def inertia_of(theta: Float[np.ndarray, "*b 10"]) -> Float[np.ndarray, "*b 3 3"]:
    """I about the origin of the body's frame [kg m^2]."""
    inertia = np.empty((*theta.shape[:-1], 3, 3))
    inertia[..., _ROWS, _COLUMNS] = inertia[..., _COLUMNS, _ROWS] = theta[..., 4:]
    return inertia


def about_center(theta: Float[np.ndarray, " 10"]) -> tuple[float, np.ndarray, np.ndarray]:
    """A body's mass [kg], its center [m], inertia about it [kg m^2] as MuJoCo can have them."""
    m = max(float(theta[0]), LEAST_MASS)
    c = theta[1:4] / m
    about = inertia_of(theta) - m * (c @ c * np.eye(3) - np.outer(c, c))
    values, vectors = np.linalg.eigh(about)
    return m, c, (vectors * np.maximum(values, LEAST_INERTIA)) @ vectors.T


@dataclass(frozen=True)
class LinkCheck:
    """The physical consistency of a link's parameters; `faults` is empty where they are."""

    name: str
    """of the body"""
    least_eigenvalue: float
    """of J, in SI units; negative where no body has these parameters"""
    faults: tuple[str, ...]
    """phrases with numbers"""

    @property
    def consistent(self) -> bool:
        """True where a body, and a joint, can have these parameters."""
        return not self.faults

    def __str__(self) -> str:
        return f"{self.name}: {'; '.join(self.faults) or 'consistent'}"


def check_links(body: RigidBody, theta: Float[np.ndarray, " D"]) -> tuple[LinkCheck, ...]:
    """Link by link, whether theta are parameters that bodies and joints can have.

    Theta is in the units of `body.units`.
    """
    blocks = theta.reshape(-1, body.width)
    return tuple(
        _check(link.name, block, body.terms)
        for link, block in zip(body.chain.bodies, blocks, strict=True)
    )


def is_positive(J: Float[np.ndarray, "*b 4 4"]) -> bool:
    """True where all J are positive semidefinite but for rounding."""
    values = np.linalg.eigvalsh(J)
    return bool((values[..., 0] >= -ROUNDING * np.abs(values[..., -1])).all())


def _check(name: str, block: Float[np.ndarray, " W"], terms: tuple[str, ...]) -> LinkCheck:
    theta = block[: len(INERTIAL)]
    J = pseudo_inertia(theta)
    faults = () if is_positive(J) else _inertial_faults(theta)
    faults += tuple(
        f"{term} {value:.4g} is negative"
        for term, value in zip(terms, block[len(INERTIAL) :], strict=True)
        if TERMS[term].positive and value < 0.0
    )
    return LinkCheck(name, float(np.linalg.eigvalsh(J)[0]), faults)


def _inertial_faults(theta: Float[np.ndarray, " 10"]) -> tuple[str, ...]:
    """Why no body has these: its mass, its inertia, or the triangle inequality of its moments."""
    m, h = theta[0], theta[1:4]
    if m <= 0.0:
        return (f"mass {m:.4g} kg is not positive",)
    about_center = inertia_of(theta) - (h @ h * np.eye(3) - np.outer(h, h)) / m
    a, b, c = np.linalg.eigvalsh(about_center)
    moments = f"principal moments {a:.4g}, {b:.4g}, {c:.4g} kg m^2 about the center of mass"
    if a < 0.0:
        return (f"{moments}: one is negative",)
    return (f"{moments}: the largest exceeds the sum of the others",)
