"""Forces that a plant's equations lack: polynomials of the motion, with a prior of their own.

    M(q) q'' + n(q, q') + r(q, q', q'') = tau,    r_j ~ GP(0, k_GIP) for each joint j

The kernel's functions are finitely many monomials of [1, z], so that r is a sum of these, each with
a weight; the prior of the weights is independent, and its standard deviations are the kernel's.

Reference: thesis eqs. (3.8) to (3.11).
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from mcpilco.data import Transitions
from mcpilco.dynamics.features import JointPolynomials
from mcpilco.gp import GP
from mcpilco.kernels import GIP, Monomials
from mcpilco.plant import (
    SCALE,
    Plant,
    PolynomialForces,
    Tables,
    mass_matrix,
    order_of,
    system_of,
    true_state,
)
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError

MOST = 1000
"""monomials that a joint's force may have"""
FASTEST = 100.0
"""of the largest acceleration recorded, that no motion exceeds [-]"""
NEGLIGIBLE = 1e-3
"""of the noise's variance, that a weight is left out below [-]"""


class MissingForces:
    """Which polynomials a plant's equations lack, and how large their weights may be."""

    roots: Float[np.ndarray, "J F"]
    """prior standard deviation of each monomial's weight; 0: it is left out"""
    most: Float[np.ndarray, " J"]
    """largest acceleration of each joint with these forces [m/s^2 or rad/s^2]"""

    def __init__(self, plant: Plant, task: TaskSpec) -> None:
        """Forces that are zero: nothing is known to be missing.

        Raises:
            InputError: so many joints have more monomials than can be learned.
        """
        self.dt = task.dt
        self.order = order_of(plant, task)
        self.kinds: list[Literal["hinge", "slide"]] = [
            "slide" if slid else "hinge" for slid in plant.layout.slides
        ]
        J = len(self.kinds)
        count = 6 ** self.kinds.count("hinge") * 3 ** self.kinds.count("slide")
        count *= 1 + J * (J + 1) // 2 + J
        if count > MOST:
            raise InputError(
                f"gip is for few joints: each of the {J} of {plant.name} would have {count} "
                f"monomials, more than {MOST}; leave gip out of the model."
            )
        entries = Monomials.of(GIP(self.kinds, (J,)).terms()).entries.T.tolist()
        self.monomials = [tuple(e - 1 for e in row if e > 0) for row in entries]
        self.roots = np.zeros((J, len(entries)))
        self.most = np.zeros(J)

    def forget(self) -> None:
        """As before any data."""
        self.roots = np.zeros_like(self.roots)
        self.most = np.zeros(len(self.kinds))

    @property
    def scales(self) -> Float[np.ndarray, " W"]:
        """Prior standard deviation of each weight that is not left out, joint by joint."""
        return self.roots[self.roots > 0]

    @property
    def forces(self) -> PolynomialForces | None:
        """The forces, as a function of the motion and of these weights; None: none is missing."""
        terms = [(int(j), self.monomials[f]) for j, f in np.argwhere(self.roots > 0)]
        return PolynomialForces(self.kinds, terms, self.most.tolist()) if terms else None

    def fit(
        self, rows: Transitions, left: Float[np.ndarray, "N J"], tables: Tables, noise_floor: float
    ) -> Float[np.ndarray, " W"]:
        """Find the prior of highest evidence, and leave out what is negligible or not worth it.

        Returns the expected weights by these samples, over their prior standard deviations: near
        what makes the steps those measured, however far the forces are from zero.

        `left` are the changes of the joints' measured velocities without those of the equations.
        """
        motion, inertia = self._motion(rows, tables)
        scale = tables.sensors[0, 1::2, SCALE]
        # the equations' own q'' of a step less the measured one is M^-1 r
        samples = -np.einsum("nij,nj->ni", inertia, left / scale) / self.dt
        floor = noise_floor / self.dt * np.sqrt((inertia**2).sum(-1).mean(0))
        self.most = FASTEST * motion[:, -len(self.kinds) :].abs().amax(0).numpy()
        X, Y = JointPolynomials(self.kinds)(motion), torch.from_numpy(samples)
        gp = GP(GIP(self.kinds, (len(self.kinds),)), noise_floor=torch.from_numpy(floor)).fit(X, Y)
        with torch.no_grad():
            phi = Monomials.of(gp.kernel.terms())
            Phi, noise = phi(X[None]), gp.noise_std.square()[:, None]
            kept = Phi.square().mean(-2) > NEGLIGIBLE * noise
            kept &= _worth_it(gp, X, Y)[:, None]
            self.roots = torch.where(kept, phi.roots, 0.0).numpy()
            # E[v | y] = Phi^T (Phi Phi^T + s^2 I)^-1 y,  v ~ N(0, I) beforehand
            Phi = Phi * kept[:, None]
            K = Phi @ Phi.mT + torch.diag_embed(noise.expand(-1, len(X)))
            v = (Phi.mT @ torch.linalg.solve(K, Y.mT[..., None]))[..., 0]
            return v[kept].numpy()

    def _motion(
        self, rows: Transitions, tables: Tables
    ) -> tuple[Float[Tensor, "N Q"], Float[np.ndarray, "N J J"]]:
        """[q, q', q''] in the middle of each step, and M(q) there; q'' is constant in a step."""
        system = system_of(tables, {})
        q, v = map(np.array, true_state(system, self.order, list(rows.states.T)))
        _, v_next = map(np.array, true_state(system, self.order, list(rows.next_states.T)))
        middle = q + self.dt * (3 * v + v_next) / 8  # positions may be wrapped between samples
        motion = np.concatenate([middle, (v + v_next) / 2, (v_next - v) / self.dt]).T
        inertia = np.array([mass_matrix(system, pose) for pose in middle.T.tolist()])
        return torch.from_numpy(np.ascontiguousarray(motion)), inertia


def _worth_it(gp: GP, X: Float[Tensor, "N D"], Y: Float[Tensor, "N J"]) -> Bool[Tensor, " J"]:
    """Whether the evidence of each joint's force exceeds that of noise alone, for the fit it took.

    Reference: G. Schwarz, Estimating the dimension of a model (1978).
    """
    N, J = Y.shape
    variance = torch.maximum(Y.square().mean(0), gp.noise_floor.square())
    alone = 0.5 * (Y.square().sum(0) / variance + N * (2 * math.pi * variance).log())
    fitted = sum(parameter.numel() for parameter in gp.kernel.parameters()) / J
    return alone - gp.nlml(X, Y) > 0.5 * fitted * math.log(N)
