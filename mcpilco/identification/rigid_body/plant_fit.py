"""Identified base parameters of a robot, as numbers of a plant with their joint distribution.

Base parameters beta are what forces tell. A plant has numbers p of its own (masses, lengths,
friction), whose logarithms x are found about the nominal ones:

    minimise  (beta(p) - beta_hat)^T C^-1 (beta(p) - beta_hat) + |x / s|^2,    p = p_0 exp(x)

so that no mass, inertia or friction is ever negative, whatever noise did to beta_hat, and what
forces do not tell stays nominal. With the Jacobian J of both terms, (J^T J)^-1 is the covariance of
x, the prior of an agent's parameters.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from mcpilco.bodies import inertial_parameters
from mcpilco.identification.rigid_body.body import RigidBody
from mcpilco.identification.rigid_body.identified import Identified
from mcpilco.plant import (
    CATALOGUE,
    Base,
    ChainPlant,
    Correction,
    EffectInstance,
    Member,
    correction_of,
    moved,
    opened,
)
from mcpilco.typing import InputError

NOMINAL = 0.2
"""standard deviation s of a logarithm before anything was recorded, of masses and sizes [-]"""
UNKNOWN = 1.0
"""the same of friction and springs, which no drawing tells [-]"""
CLOSEST = 1e-3
"""least standard deviation of a base parameter, relative to it [-]"""
FARTHEST = 3.0
"""that a logarithm goes from nominal, a factor of 20 [-]"""
STEP = 1e-4
"""of a logarithm, by which a number is seen to matter [-]"""
EFFECTS: Mapping[str, str] = {
    "viscous": "viscous_friction",
    "coulomb": "coulomb_friction",
    "armature": "armature",
    "stiffness": "spring",
    "offset": "constant_force",
}
"""the effect that is a term of `RigidBody`, by its name"""


def correction_of_identified(plant: ChainPlant, found: Identified) -> Correction:
    """The correction that gives a plant what was identified, with its joint distribution.

    Args:
        plant: nominal, with the joints that were identified.
        found: base parameters, and their covariance.

    Raises:
        InputError: the plant has other joints, or no number that the forces tell.
    """
    if set(plant.chain.joints) != set(found.body.chain.joints):
        raise InputError(
            f"{plant.name} must have the joints {', '.join(found.body.chain.joints)}, got "
            f"{', '.join(plant.chain.joints)}; identify with the plant's own model."
        )
    source = plant.having(list(_lacking(plant, found)))
    wide = opened(_with_found_terms(source, found))
    names, std = _told(wide, found)
    start = np.array([wide.values[name] for name in names])
    error = found.covariance + np.diag((CLOSEST * np.abs(found.beta)) ** 2 + 1e-18)
    whiten = np.linalg.inv(np.linalg.cholesky(error))

    def residuals(x: Float[np.ndarray, " K"]) -> Float[np.ndarray, " B_plus_K"]:
        there = wide.where(**dict(zip(names, start * np.exp(x), strict=True)))
        beta = found.base.of(theta_of(there, found.body))
        return np.concatenate([whiten @ (beta - found.beta), x / std])

    search = least_squares(residuals, np.zeros(len(names)), bounds=(-FARTHEST, FARTHEST))
    values = dict(zip(names, (start * np.exp(search.x)).tolist(), strict=True))
    covariance = np.linalg.inv(search.jac.T @ search.jac)
    spread = np.sqrt(np.diag(covariance))
    correlation = tuple(map(tuple, (covariance / np.outer(spread, spread)).tolist()))
    sizes = {n: abs(v) * float(s) for (n, v), s in zip(values.items(), spread, strict=True)}
    correction = correction_of(moved(source, values), plant)
    return replace(correction, spread=(Member(1.0, values, sizes, correlation),))


def theta_of(plant: ChainPlant, body: RigidBody) -> Float[np.ndarray, " D"]:
    """The parameters of a robot that a plant says, in the units of `body.units`."""
    links = {link.joint: link for link in plant.chain.bodies}
    blocks = []
    for joint in body.chain.joints:
        terms = [sum(_values(plant, joint, term)) for term in body.terms]
        blocks.append(np.append(inertial_parameters(links[joint]), terms))
    return np.concatenate(blocks)


def _values(plant: ChainPlant, joint: str, term: str) -> Iterator[float]:
    """The values of a plant's term at a joint, effect by effect."""
    if term == "armature":
        yield next(link.armature for link in plant.chain.bodies if link.joint == joint)
    for base in plant.base:
        if _is(base, term, joint):
            first = base.values[0]
            yield plant.values[first] if isinstance(first, str) else first


def _is(base: Base, term: str, joint: str) -> bool:
    """Whether an effect that belongs to a plant is a term at a joint, or a general form of it."""
    effect, name = base.active.effect, EFFECTS[term]
    return name in (effect.name, *effect.special) and base.active.target == joint


def _lacking(
    plant: ChainPlant, found: Identified
) -> Iterator[tuple[EffectInstance, tuple[float, ...]]]:
    """The terms that were found at joints where the plant has none."""
    for joint, term, value in _terms(found):
        effect = CATALOGUE[EFFECTS[term]]
        if value != 0.0 and not any(_is(base, term, joint) for base in plant.base):
            more = [float(symbol.neutral) for symbol in effect.symbols[1:]]
            yield EffectInstance(effect, joint), (value, *more)


def _with_found_terms(plant: ChainPlant, found: Identified) -> ChainPlant:
    """The plant whose parameters of friction and springs begin where they were found."""
    named = {}
    for joint, term, value in _terms(found):
        name = plant.parameter_of(EffectInstance(CATALOGUE[EFFECTS[term]], joint))
        if name is not None and value > 0.0:
            named[name] = value
    return plant.where(**named)


def _terms(found: Identified) -> Iterator[tuple[str, str, float]]:
    """Joint, term and value of all that joints have besides their bodies."""
    body = found.body
    blocks = found.theta.reshape(-1, body.width)[:, -len(body.terms) :] if body.terms else ()
    for joint, block in zip(body.chain.joints, blocks, strict=False):
        for term, value in zip(body.terms, block, strict=True):
            yield joint, term, float(value)


def _told(plant: ChainPlant, found: Identified) -> tuple[list[str], Float[np.ndarray, " K"]]:
    """The numbers of a plant that its forces tell of, and how well each is known beforehand.

    Lengths between joints are not among them: the regressor took them as they are.
    """
    frictions = {v for base in plant.base for v in base.values if isinstance(v, str)}
    before, frames = found.base.of(theta_of(plant, found.body)), _frames(plant)
    names = []
    for name, value in plant.values.items():
        there = plant.where(**{name: value * (1.0 + STEP)})
        moves = np.abs(found.base.of(theta_of(there, found.body)) - before).max() > 0.0
        if moves and _frames(there) == frames:
            names.append(name)
    if not names:
        raise InputError(f"{plant.name} has no number that the forces of its joints tell.")
    return names, np.array([UNKNOWN if name in frictions else NOMINAL for name in names])


def _frames(plant: ChainPlant) -> list[object]:
    """Where the joints of a plant are, and gravity."""
    joints = [(link.origin, link.rotation, link.axis) for link in plant.chain.bodies]
    return [*joints, plant.chain.gravity]
