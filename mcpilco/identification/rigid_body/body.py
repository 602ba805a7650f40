"""The forces in a robot's joints, linear in its parameters: tau = Y(q, q', q'') theta.

`RigidBody` is the chain with its regressor Y; `base_parameters` finds the parameters, and the sums
of parameters, that forces depend on. `check_links` says, link by link, whether a body can have
parameters: its mass m, first moment h and inertia I about the origin are those of some distribution
of (positive) masses exactly where its pseudo-inertia

    J = [ tr(I)/2 1 - I   h ]  =  sum over masses of  m [x; 1] [x; 1]^T
        [ h^T             m ]

is positive semidefinite. J is linear in the parameters.

Reference: Wensing, Kim, Slotine, Linear matrix inequalities for physically consistent inertial
    parameter identification, IEEE Robotics and Automation Letters 3 (1), 2018.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import qr, solve_triangular

from mcpilco.bodies import INERTIAL, SLIDE, Chain, inertial_parameters, regressor
from mcpilco.config import TURN_OVER
from mcpilco.mjcf import chain_of
from mcpilco.plant import CoulombFriction, Spring, ViscousFriction
from mcpilco.recordings import JointMotion
from mcpilco.typing import InputError

Motion = Float[np.ndarray, "N J"]
"""of J joints: positions q [m or rad], velocities q' [m/s or rad/s] or accelerations q''"""


class Term(NamedTuple):
    """A force in a joint that has one parameter."""

    column: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    """what multiplies the parameter, of q, q' and q''"""
    unit: str
    """of the parameter; f is the joint's force, q its position"""
    positive: bool = True
    """whether a negative value makes no sense"""


TERMS: Mapping[str, Term] = {
    "viscous": Term(lambda q, dq, ddq: ViscousFriction.force(q, dq, -1.0), "{f} s/{q}"),
    "coulomb": Term(lambda q, dq, ddq: CoulombFriction.force(q, dq, -1.0, TURN_OVER), "{f}"),
    "armature": Term(lambda q, dq, ddq: ddq, "{f} s^2/{q}"),
    "stiffness": Term(lambda q, dq, ddq: Spring.force(q, dq, -1.0), "{f}/{q}"),
    "offset": Term(lambda q, dq, ddq: np.ones_like(q), "{f}", positive=False),
}
"""what a joint may have besides the body that it carries; the seed has viscous friction alone"""


@dataclass(frozen=True)
class RigidBody:
    """An open chain of rigid bodies whose parameters are to be found.

    theta has a block for each joint, in the order of q: the `INERTIAL` parameters of the joint's
    body, about the origin of its frame in the joint, and then the joint's `terms`.
    """

    chain: Chain
    """joints, frames and gravity, which are known; masses and inertias are the nominal ones"""
    terms: tuple[str, ...]
    """keys of `TERMS`"""
    nominal: Float[np.ndarray, " D"]
    """theta of the model that this was made of"""

    @classmethod
    def of(
        cls, model: mujoco.MjModel, terms: tuple[str, ...] = ("viscous", "coulomb", "armature")
    ) -> RigidBody:
        """The parameters that a MuJoCo model has, and the regressor of their forces.

        Y theta with the nominal theta is what `mujoco.mj_inverse` finds, where `terms` hold all
        that the model's joints have. MuJoCo finds dry friction from its constraints, not from a
        formula: while a joint moves faster than `TURN_OVER` the two agree.

        The model is an open chain of hinges and slides; its contacts and actuators do not matter.

        Raises:
            InputError: a term is unknown, or the model is no such chain.
        """
        unknown = [term for term in terms if term not in TERMS]
        if unknown or len(set(terms)) != len(terms):
            raise InputError(f"terms must be some of {', '.join(TERMS)}, each once, got {terms}.")
        chain = chain_of(model)
        dof = model.jnt_dofadr
        rest = model.qpos_spring[model.jnt_qposadr]
        values = {
            "viscous": model.dof_damping[dof],
            "coulomb": model.dof_frictionloss[dof],
            "armature": model.dof_armature[dof],
            "stiffness": model.jnt_stiffness,
            "offset": -model.jnt_stiffness * rest,
        }
        blocks = [
            np.append(inertial_parameters(body), [values[term][j] for term in terms])
            for j, body in enumerate(chain.bodies)
        ]
        return cls(chain, terms, np.concatenate(blocks))

    @property
    def width(self) -> int:
        """How many parameters a joint has."""
        return len(INERTIAL) + len(self.terms)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the D parameters: `<body>_m`, ..., `<joint>_viscous`."""
        return tuple(
            name
            for body in self.chain.bodies
            for name in (
                *(f"{body.name}_{symbol}" for symbol in INERTIAL),
                *(f"{body.joint}_{term}" for term in self.terms),
            )
        )

    @property
    def units(self) -> tuple[str, ...]:
        """Of the D parameters."""
        inertial = ["kg", *["kg m"] * 3, *["kg m^2"] * 6]
        found: list[str] = []
        for body in self.chain.bodies:
            f, q = ("N", "m") if body.kind == SLIDE else ("N m", "rad")
            found += [*inertial, *(TERMS[term].unit.format(f=f, q=q) for term in self.terms)]
        return tuple(found)

    def regressor(self, q: Motion, dq: Motion, ddq: Motion) -> Float[np.ndarray, "N J D"]:
        """Y(q, q', q''): a column of forces for each parameter [N or N m a unit of it].

        Raises:
            InputError: the arrays are no motion of this chain.
        """
        joints = len(self.chain.bodies)
        for name, array in (("q", q), ("dq", dq), ("ddq", ddq)):
            if np.shape(array) != (len(q), joints) or not np.isfinite(array).all():
                raise InputError(
                    f"{name} must hold finite numbers in the shape {(len(q), joints)}, a column "
                    f"for each of {', '.join(self.chain.joints)}, got shape {np.shape(array)}; "
                    "give all joints, and leave out rows with gaps."
                )
        Y = np.zeros((len(q), joints, joints, self.width))
        Y[..., : len(INERTIAL)] = regressor(self.chain, q, dq, ddq)
        each = np.arange(joints)
        for place, term in enumerate(self.terms, len(INERTIAL)):
            Y[:, each, each, place] = TERMS[term].column(q, dq, ddq)
        return Y.reshape(len(q), joints, joints * self.width)

    def regressor_of(self, motion: JointMotion) -> Float[np.ndarray, "N J D"]:
        """`regressor` of a filtered motion, with its `dry` for the columns of dry friction."""
        Y = self.regressor(motion.q, motion.dq, motion.ddq)
        if "coulomb" in self.terms:
            N, J, _ = Y.shape
            each, place = np.arange(J), len(INERTIAL) + self.terms.index("coulomb")
            Y.reshape(N, J, J, self.width)[:, each, each, place] = motion.dry
        return Y


def random_motions(
    body: RigidBody, count: int, rng: np.random.Generator
) -> tuple[Motion, Motion, Motion]:
    """Random q, q' and q'' that excite every parameter that forces depend on.

    Positions are drawn from all around [rad] or within a metre, velocities and accelerations are
    standard normal, three and ten times.
    """
    shape = (count, len(body.chain.bodies))
    slides = np.array([b.kind == SLIDE for b in body.chain.bodies])
    q = rng.uniform(-1.0, 1.0, shape) * np.where(slides, 1.0, np.pi)
    return q, 3.0 * rng.normal(size=shape), 10.0 * rng.normal(size=shape)


TOLERANCE = 1e-9
"""relative size of a column of R below which it depends on those before"""
ROUNDING = 1e-12
"""length of a column, relative to the longest, below which it is 0"""


@dataclass(frozen=True)
class BaseParameters:
    """Columns of a regressor that are independent, and how the others depend on them.

        Y theta = Y[:, independent] beta,    beta = theta[independent] + K theta[dependent]

    so that forces determine beta and nothing else.

    Reference: Gautier, Numerical calculation of the base inertial parameters of robots, J. Robotic
    Systems 8 (4), 1991.
    """

    independent: Int[np.ndarray, " B"]
    """ascending"""
    dependent: Int[np.ndarray, " R"]
    """ascending; also those that no force depends on"""
    K: Float[np.ndarray, "B R"]
    """0 where beta does not depend on a parameter"""

    def __len__(self) -> int:
        return len(self.independent)

    def of(self, theta: Float[np.ndarray, " D"]) -> Float[np.ndarray, " B"]:
        """beta, in the units of the independent parameters."""
        return theta[self.independent] + self.K @ theta[self.dependent]

    def columns(self, Y: Float[np.ndarray, "*b D"]) -> Float[np.ndarray, "*b B"]:
        """The independent columns of a regressor."""
        return Y[..., self.independent]

    def near(
        self, beta: Float[np.ndarray, " B"], theta: Float[np.ndarray, " D"]
    ) -> Float[np.ndarray, " D"]:
        """The parameters that have these base parameters, and theta's dependent parameters."""
        found = theta.copy()
        found[self.independent] = beta - self.K @ theta[self.dependent]
        return found

    def formulas(self, names: tuple[str, ...], least: float = 1e-6) -> tuple[str, ...]:
        """Each base parameter as a sum of parameters, for readers.

        Factors of a size below `least` are not written.
        """
        found = []
        for row, first in zip(self.K, self.independent, strict=True):
            parts = [
                f"{'+' if factor > 0 else '-'} {abs(factor):.4g} {names[other]}"
                for factor, other in zip(row, self.dependent, strict=True)
                if abs(factor) > least
            ]
            found.append(" ".join([names[first], *parts]))
        return tuple(found)


def base_parameters(Y: Float[np.ndarray, "*b D"], tolerance: float = TOLERANCE) -> BaseParameters:
    """The base parameters of a regressor, by a QR factorisation without pivots.

    Of dependent columns the first stays. With Y of `random_motions` they are those of the robot;
    with Y of a recording those that the recording determines.

    Y has more than D rows, of any samples and joints; a column depends on others where `tolerance`
    of its length is left of it.
    """
    rows = Y.reshape(-1, Y.shape[-1])
    length = np.linalg.norm(rows, axis=0)
    used = length > ROUNDING * length.max(initial=0.0)
    scale = np.where(used, length, np.inf)
    T, kept = _echelon(qr(rows / scale, mode="r")[0][: Y.shape[-1]], tolerance)
    others = np.setdiff1d(np.arange(T.shape[1]), kept)
    K = solve_triangular(T[: len(kept), kept], T[: len(kept), others])
    return BaseParameters(kept, others, K * (length * used)[others] / length[kept][:, None])


def _echelon(
    rows: Float[np.ndarray, "M D"], tolerance: float
) -> tuple[Float[np.ndarray, "M D"], Int[np.ndarray, " B"]]:
    """Q^T rows in echelon form, and the columns in which its steps are: Householder's reflections.

    A column that is dependent takes no step, so none of the later ones is divided by next to 0.
    """
    T = rows.copy()
    kept: list[int] = []
    for column in range(T.shape[1]):
        v = T[len(kept) :, column].copy()
        size = np.linalg.norm(v)
        if size > tolerance:
            v[0] += np.copysign(size, v[0])
            v /= np.linalg.norm(v)
            T[len(kept) :] -= 2.0 * np.outer(v, v @ T[len(kept) :])
            kept.append(column)
    return T, np.array(kept, dtype=int)


_ROUNDED = 1e-9
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


def _check(name: str, block: Float[np.ndarray, " W"], terms: tuple[str, ...]) -> LinkCheck:
    theta = block[: len(INERTIAL)]
    values = np.linalg.eigvalsh(pseudo_inertia(theta))
    faults = () if values[0] >= -_ROUNDED * abs(values[-1]) else _inertial_faults(theta)
    faults += tuple(
        f"{term} {value:.4g} is negative"
        for term, value in zip(terms, block[len(INERTIAL) :], strict=True)
        if TERMS[term].positive and value < 0.0
    )
    return LinkCheck(name, float(values[0]), faults)


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
