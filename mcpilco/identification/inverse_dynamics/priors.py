"""Priors over the torque of one joint: features of a motion, and a kernel of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.bodies import Chain
from mcpilco.dynamics import JointPolynomials, friction
from mcpilco.identification.inverse_dynamics.physics import PhysicalFeatures
from mcpilco.kernels import GIP, RBF, ActiveDims, Kernel, Kind, Linear


class Prior(ABC):
    """Zero-mean Gaussian processes, one a joint, all with one kernel of features of their own."""

    @abstractmethod
    def features(self, motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J D"]:
        """What the process of each joint regresses on, differentiable by the motion."""

    @abstractmethod
    def kernel(self) -> Kernel:
        """A new kernel of D features, for one output."""


@final
class Nonparametric(Prior):
    """k(x, x') = RBF of positions, velocities and accelerations: nothing is known of the robot.

    Args:
        joints: J.

    Reference: thesis section 3.2.2.
    """

    def __init__(self, joints: int) -> None:
        self.joints = joints

    def features(self, motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J D"]:
        return motion[..., None, :].expand(*motion.shape[:-1], self.joints, -1)

    def kernel(self) -> Kernel:
        return RBF(3 * self.joints, (1,))


@final
class Parametric(Prior):
    """k_i(x, x') = phi_i(x)^T Sigma phi_i(x'), Sigma diagonal: the geometry is known.

    Args:
        chain: joints, frames and gravity.
        friction: whether joints have friction.

    Reference: thesis eq. (3.6), with mean 0.
    """

    def __init__(self, chain: Chain, friction: bool) -> None:
        self.features_of = PhysicalFeatures(chain, friction)

    def features(self, motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J D"]:
        return self.features_of(motion)

    def kernel(self) -> Kernel:
        return Linear(len(self.features_of.names), (1,), bias=False)


@final
class Semiparametric(Prior):
    """The parametric kernel plus an RBF of the motion, for what the geometry gets wrong.

    Reference: thesis eq. (3.7).
    """

    def __init__(self, chain: Chain, friction: bool) -> None:
        self.parametric = Parametric(chain, friction)
        self.rest = Nonparametric(len(chain.bodies))

    def features(self, motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J D"]:
        return torch.cat([self.parametric.features(motion), self.rest.features(motion)], -1)

    def kernel(self) -> Kernel:
        return side_by_side(self.parametric.kernel(), self.rest.kernel())


@final
class Geometric(Prior):
    """The GIP kernel: the kinds of the joints are known, and nothing else.

    Args:
        kinds: of the joints.
        friction: whether joints have friction, a linear kernel besides, for it is no polynomial.

    Reference: thesis eq. (3.11).
    """

    def __init__(self, kinds: Sequence[Kind], friction: bool) -> None:
        self.kinds, self.friction = tuple(kinds), friction
        self.polynomials = JointPolynomials(self.kinds)

    def features(self, motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J D"]:
        J = len(self.kinds)
        z = self.polynomials(motion)[..., None, :].expand(*motion.shape[:-1], J, -1)
        return torch.cat([z, friction(motion[..., J : 2 * J])], -1) if self.friction else z

    def kernel(self) -> Kernel:
        gip = GIP(self.kinds, (1,))
        return side_by_side(gip, Linear(2, (1,), bias=False)) if self.friction else gip


def side_by_side(first: Kernel, second: Kernel) -> Kernel:
    """The sum of a kernel of the first regressors and one of those behind them."""
    width = first.width + second.width
    return ActiveDims(first, range(first.width), width) + ActiveDims(
        second, range(first.width, width), width
    )
