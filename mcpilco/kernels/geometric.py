"""A prior over the inverse dynamics of any robot whose kinds of joints are known."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, cast

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.kernels.base import ActiveDims, Kernel, Product
from mcpilco.kernels.polynomial import MPK
from mcpilco.typing import InputError

Kind = Literal["hinge", "slide"]

HARMONICS = 0.1
"""start of a position's weight, in parts of its factor's offset [-]"""
_SMALLEST = 1e-12
"""least mean square that a regressor is scaled by, in its squared unit"""


class GIP(Product):
    """k(z, z') = prod_hinges mpk2([c, s]) prod_slides mpk2([q]) mpk1([q'q', q'']): eq. (3.11).

    The torque of a joint, by Lagrange's equations, is a polynomial in the entries of z: of degree 2
    in cosine and sine of each hinge, and in the position of each slide, and of degree 1 in the
    products of velocities and the accelerations. The kernel's functions are these polynomials, for
    every robot with such joints; nothing but the kinds of the joints is told.

    z is [cos(hinges), sin(hinges), slides, products of velocities, accelerations]: what
    `mcpilco.dynamics.features.JointPolynomials` makes of q, q' and q''.

    Args:
        kinds: of the J joints, `hinge` or `slide` each.
        batch: shape of the hyperparameters, `(E,)` for the E outputs of a GP.

    Reference: thesis eqs. (3.8), (3.10) and (3.11), proposition 3.3.1.
    """

    def __init__(self, kinds: Sequence[Kind], batch: Sequence[int] = ()) -> None:
        kinds = tuple(kinds)
        if not kinds or any(kind not in ("hinge", "slide") for kind in kinds):
            raise InputError(f"GIP needs a kind for each joint, hinge or slide, got {kinds}.")
        J, hinges = len(kinds), kinds.count("hinge")
        angles = [(h, hinges + h) for h in range(hinges)]
        slides = [(2 * hinges + p,) for p in range(J - hinges)]
        first = J + hinges  # of the motion
        width = first + J * (J + 1) // 2 + J
        factors: list[Kernel] = [
            ActiveDims(MPK(len(dims), 2, batch), dims, width) for dims in (*angles, *slides)
        ]
        motion = range(first, width)
        super().__init__(*factors, ActiveDims(MPK(len(motion), 1, batch), motion, width))
        self.kinds = kinds

    def start_from(self, X: Float[Tensor, "N D"], Y: Float[Tensor, " N *b"]) -> None:
        """Forces that depend a little on each position, and equally on all that moves.

        Every factor of a position is near 1: where positions outweigh the offsets of many joints,
        the product is all but white noise, and a fit stalls at torques that are noise throughout.
        """
        *positions, motion = cast(Sequence[ActiveDims], self.parts)
        for factor in positions:
            mpk = cast(MPK, factor.kernel)
            size = X[:, factor.dims].square().mean(0).clamp_min(_SMALLEST)
            mpk.offset_steps = mpk.spread(torch.tensor([1e-3, 1.0]), 2)
            mpk.weight_steps = mpk.spread(HARMONICS / size, 2, mpk.width)
        motion.start_from(X, torch.ones_like(Y))
        power = Y.square().mean(0)
        power = torch.where(power > 0, power, torch.ones_like(power)) / self.diag(X).mean(-1)
        mpk = cast(MPK, motion.kernel)
        mpk.offset_steps = mpk.offset_steps * power[..., None]
        mpk.weight_steps = mpk.weight_steps * power[..., None, None]
