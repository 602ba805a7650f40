"""Laws of the kernels of robots: forward kinematics, and the prior over inverse dynamics."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch

from envs.arms.marked import Link, marked_arm
from envs.arms.motions import random_motion
from envs.arms.robots import ur10
from mcpilco.bodies import generalised_forces
from mcpilco.dynamics import JointPolynomials
from mcpilco.gp import GP
from mcpilco.kernels import Kinematic, NestedKinematic
from mcpilco.kernels.mechanical import GIP
from mcpilco.typing import InputError
from tests.mcpilco.kernels.test_kernels import points, shake

CHAINS = list(itertools.product(("hinge", "slide"), repeat=3))


def regressors(q: np.ndarray, kinds: tuple[str, ...]) -> torch.Tensor:
    turns = [k for k, kind in enumerate(kinds) if kind == "hinge"]
    slides = [k for k, kind in enumerate(kinds) if kind == "slide"]
    parts = np.cos(q[:, turns]), np.sin(q[:, turns]), q[:, slides]
    return torch.as_tensor(np.concatenate(parts, axis=1))


@pytest.mark.parametrize("kernel", [Kinematic, NestedKinematic])
@pytest.mark.parametrize("kinds", CHAINS, ids=lambda kinds: "".join(k[0] for k in kinds))
def test_every_pose_of_every_chain_is_in_the_span(kernel, kinds) -> None:
    rng = np.random.default_rng(0)
    links = [Link(kind, *rng.uniform(-1.0, 1.0, 4)) for kind in kinds]
    arm = marked_arm(links, rng)
    q = rng.uniform(-1.5, 1.5, (120, 3))
    positions, orientations = arm.poses(q)
    matrices = orientations.as_matrix().reshape(120, 4, 9)[:, -1]
    Y = torch.as_tensor(np.concatenate([positions[:, -1], matrices], axis=1))
    X = regressors(q, kinds)
    k = kernel(kinds)
    K = k(X, X[:60])
    coefficients = torch.linalg.lstsq(K[:60], Y[:60], driver="gelsd", rcond=1e-11).solution
    torch.testing.assert_close(K[60:] @ coefficients, Y[60:], rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("kinds", CHAINS, ids=lambda kinds: "".join(k[0] for k in kinds))
def test_as_many_monomials_as_the_proposition_counts(kinds) -> None:
    X = torch.randn(200, 6, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    R, P = kinds.count("hinge"), kinds.count("slide")
    X = X[:, : 2 * R + P]
    rank = int(torch.linalg.matrix_rank(Kinematic(kinds)(X, X), rtol=1e-12))
    nested = int(torch.linalg.matrix_rank(NestedKinematic(kinds)(X, X), rtol=1e-12))
    assert rank == 3**R * (1 + P)
    assert nested <= rank


def test_unknown_joints_are_refused() -> None:
    with pytest.raises(InputError, match="hinge or slide, one at least, got ball"):
        Kinematic(("hinge", "ball"))
    with pytest.raises(InputError, match="got none"):
        NestedKinematic(())


KINDS = ("hinge", "slide", "hinge")


def joint_regressors(n: int, seed: int = 0) -> torch.Tensor:
    return JointPolynomials(KINDS)(points(n, 9, seed=seed))


def test_gip_is_the_product_that_the_thesis_writes():
    kernel, Z1, Z2 = shake(GIP(KINDS, (2,))), joint_regressors(4), joint_regressors(3, seed=1)
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
    kernel, Z = GIP(KINDS, (2,)), joint_regressors(50)
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


@pytest.mark.slow
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
