"""Features that a robot's geometry gives: its torques are linear in them."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.bodies import INERTIAL, Chain, torch_regressor
from mcpilco.dynamics import friction
from mcpilco.identification.rigid_body import RigidBody


class PhysicalFeatures:
    """Row j of Phi of tau = Phi(q, q', q'') w, for each joint j: eq. (3.2).

    The columns are those of `mcpilco.identification.rigid_body`: a block for each joint, of the
    inertial parameters of its body, and then of the joint's armature and friction.

    Args:
        chain: joints, frames and gravity; masses and inertias do not matter.
        friction: whether joints have viscous and Coulomb friction.
    """

    def __init__(self, chain: Chain, friction: bool) -> None:
        self.chain, self.friction = chain, friction
        terms = ("armature", "viscous", "coulomb") if friction else ("armature",)
        count = len(chain.bodies) * (len(INERTIAL) + len(terms))
        self.names = RigidBody(chain, terms, np.zeros(count)).names
        """of the columns"""

    def __call__(self, motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J D"]:
        """Phi, differentiable by the motion."""
        _, dq, ddq = motion.split(len(self.chain.bodies), -1)
        own = [ddq[..., None], friction(dq)] if self.friction else [ddq[..., None]]
        terms = torch.cat(own, -1)  # *b J T
        spread = torch.diag_embed(terms.mT).movedim(-3, -1)  # *b J J T
        return torch.cat([torch_regressor(self.chain, motion), spread], -1).flatten(-2)
