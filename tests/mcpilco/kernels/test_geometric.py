from __future__ import annotations

import numpy as np
import pytest
import torch

from envs.arms.random_motion import random_motion
from envs.arms.ur10 import ur10
from mcpilco.bodies import generalised_forces
from mcpilco.dynamics import JointPolynomials
from mcpilco.gp import GP
from mcpilco.kernels.geometric import GIP
from mcpilco.typing import InputError
from tests.mcpilco.kernels.test_kernels import points, shake

KINDS = ("hinge", "slide", "hinge")


def regressors(n: int, seed: int = 0) -> torch.Tensor:
    return JointPolynomials(KINDS)(points(n, 9, seed=seed))


def test_gip_is_the_product_that_the_thesis_writes():
    kernel, Z1, Z2 = shake(GIP(KINDS, (2,))), regressors(4), regressors(3, seed=1)
    c1, s1, p1, m1 = Z1.split([2, 2, 1, 9], -1)
    c2, s2, p2, m2 = Z2.split([2, 2, 1, 9], -1)
    pairs = [
        (torch.stack([c1[:, b], s1[:, b]], -1), torch.stack([c2[:, b], s2[:, b]], -1))
        for b in range(2)
    ]
    expected = torch.ones(2, 4, 3).double()
    for part, (a, b) in zip(kernel.parts, [*pairs, (p1, p2), (m1, m2)], strict=True):
        for offset, weights in zip(
            part.kernel.offsets.unbind(-1), part.kernel.weights.unbind(-2), strict=True
        ):
            inner = torch.einsum("ed,nd,md->enm", weights, a, b)
            expected = expected * (offset[:, None, None] + inner)
    torch.testing.assert_close(kernel(Z1, Z2), expected)


def test_start_gives_the_prior_the_mean_square_of_the_targets():
    kernel, Z = GIP(KINDS, (2,)), regressors(50)
    Y = points(50, 2, seed=2) * torch.tensor([0.3, 7.0]).double()
    kernel.start_from(Z, Y)
    torch.testing.assert_close(kernel.diag(Z).mean(-1), Y.square().mean(0))


def test_at_the_start_the_factor_of_every_position_is_near_one():
    """A product of six full polynomials would be all but white noise."""
    kinds = ("hinge",) * 6
    kernel, Z = GIP(kinds), JointPolynomials(kinds)(points(60, 18))
    kernel.start_from(Z, points(60, 1)[:, 0])
    for factor in kernel.parts[:-1]:
        K = factor(Z, Z)
        assert 0.3 < K.min() < 1.0 < K.max() < 2.5


@pytest.mark.parametrize("kinds", [(), ("hinge", "ball")])
def test_other_joints_are_refused(kinds):
    with pytest.raises(InputError, match="hinge or slide"):
        GIP(kinds)


def test_a_fit_of_six_joints_does_not_stall_where_it_starts():
    """From logarithms of -1 each it does: the whole torque of the shoulder is taken for noise."""
    rng, robot = np.random.default_rng(0), ur10()
    motion = random_motion(robot, rng, 200, 0.4)
    tau = generalised_forces(robot, *motion)[:, 1:2] + 0.01 * rng.normal(size=(200, 1))
    kinds = ("hinge",) * 6
    Z = JointPolynomials(kinds)(torch.as_tensor(np.concatenate(motion, 1)))
    noise = [
        float(
            GP(kernel, noise_floor=1e-4 * tau.std()).fit(Z, torch.as_tensor(tau)).noise_std.detach()
        )
        for kernel in (GIP(kinds, (1,)), Stalling(kinds, (1,)))
    ]
    assert noise[0] < 0.01 * tau.std() < 0.5 * tau.std() < noise[1]


class Stalling(GIP):
    def start_from(self, X: torch.Tensor, Y: torch.Tensor) -> None:
        with torch.no_grad():
            for log in self.parameters():
                log.fill_(-1.0)
